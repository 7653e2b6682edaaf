//! The vertices of a surface net on the creases and corners of what depth images show. The zero of a
//! mean distance is rounded by about a voxel, and lies beside every crease; the pixels near it say how
//! the planes run that meet there. Each vertex goes where their squared distances are least (the
//! quadric error of Ju et al. 2002, "Dual Contouring of Hermite Data", with pixels in the place of the
//! grid's crossings). Called by `depth_mesh`.

use super::range_image::RangeImage;
use super::surface_nets::Net;
use crate::core::parallel::prelude::*;
use crate::core::stats::median;
use glam::{DVec3, Vec3};
use nalgebra::{Matrix3, Vector3};

/// Voxels around a vertex whose pixels say how the surface runs there. Derived: what lies in its own cell
/// and halfway into the next, where the other side of a crease is if it is not in its own.
const REACH: f32 = 1.5;
/// Voxels a vertex moves at most along an axis. Derived: beyond its own cell and the next it would pass other vertices.
const FARTHEST: f64 = 1.0;
/// Pixels to every side of the one that looks at a vertex. Derived: 25 of an image, so that near images
/// cost no more than others.
const AROUND: isize = 2;
/// Scatter of unit normals, squared, that no depth image goes below. Derived: 3°, the turn of a plane
/// between pixels whose depth is right to a thousandth of their distance.
const LEAST_SCATTER: f64 = 0.0025;

/// What the pixels around a vertex say, relative to it, in voxels.
#[derive(Clone, Copy)]
struct Planes {
    /// Mean of n nᵀ.
    turns: Matrix3<f64>,
    /// Mean of n (n·p): where the planes lie.
    offsets: Vector3<f64>,
    /// The middle eigenvalue of `turns`: 0 on a plane; on a crease the squared sine of half the angle
    /// between its two planes, seen equally.
    bent: f64,
}

/// A net's vertices, in units of its grid, on the creases that `images` see, and the net in triangles:
/// each square is parted along the crease that crosses it. `voxel`: metres.
pub fn creased(net: &Net, images: &[RangeImage], voxel: f32) -> (Vec<Vec3>, Vec<[u32; 3]>) {
    let normals = normals(net);
    let asked = net.positions.par_iter().zip(&normals);
    let planes: Vec<Option<Planes>> = asked.map(|(p, n)| seen(*p, *n, images, voxel)).collect();
    let bends: Vec<f32> = planes.iter().flatten().map(|p| p.bent as f32).collect();
    // most surface is flat: what bends most of it is noise
    let scatter = f64::from(median(bends).unwrap_or(0.0));
    let moved = |i: usize| {
        let shift = planes[i].and_then(|p| p.nearest(scatter));
        net.positions[i] + shift.unwrap_or(Vec3::ZERO)
    };
    let mut places: Vec<Vec3> = (0..planes.len()).into_par_iter().map(moved).collect();
    unfold(net, &normals, &mut places);
    let bent = |i: u32| planes[i as usize].map_or(0.0, |p| p.bent);
    let halves = |&[i, j, k, l]: &[u32; 4]| {
        if bent(i) + bent(k) >= bent(j) + bent(l) {
            [[i, j, k], [i, k, l]]
        } else {
            [[j, k, l], [j, l, i]]
        }
    };
    let triangles = net.squares.iter().flat_map(halves).collect();
    (places, triangles)
}

/// Unit normals of a net's vertices, means over their squares.
fn normals(net: &Net) -> Vec<Vec3> {
    let mut normals = vec![Vec3::ZERO; net.positions.len()];
    for square in &net.squares {
        let across = crossed(square, &net.positions);
        square.iter().for_each(|i| normals[*i as usize] += across);
    }
    normals.iter().map(|n| n.normalize_or_zero()).collect()
}

/// Twice a square's area, along its normal.
fn crossed(square: &[u32; 4], places: &[Vec3]) -> Vec3 {
    let [i, j, k, l] = square.map(|i| places[i as usize]);
    (k - i).cross(l - j)
}

/// Puts vertices back whose squares have turned over.
fn unfold(net: &Net, normals: &[Vec3], places: &mut [Vec3]) {
    let over = |square: &&[u32; 4]| {
        let facing: Vec3 = square.iter().map(|i| normals[*i as usize]).sum();
        crossed(square, places).dot(facing) <= 0.0
    };
    let turned: Vec<[u32; 4]> = net.squares.iter().filter(over).copied().collect();
    for i in turned.into_iter().flatten() {
        places[i as usize] = net.positions[i as usize];
    }
}

/// The planes around a vertex that lies at `place`, in voxels, and faces along `normal`; `None` where no
/// pixel sees one.
fn seen(place: Vec3, normal: Vec3, images: &[RangeImage], voxel: f32) -> Option<Planes> {
    let (mut turns, mut offsets, mut whole) = (Matrix3::zeros(), Vector3::zeros(), 0.0);
    let metres = place * voxel;
    for image in images {
        let Some(middle) = image.looking_at(metres) else {
            continue;
        };
        let away = (metres - image.camera.position).length();
        let wide = away * image.camera.pixel_angle(image.pixel(middle));
        let step = REACH * voxel / wide / AROUND as f32;
        let step = (step as isize).clamp(1, image.depth.width as isize);
        for k in 0..(2 * AROUND + 1).pow(2) {
            let [across, down] =
                [k % (2 * AROUND + 1), k / (2 * AROUND + 1)].map(|v| (v - AROUND) * step);
            let Some(pixel) = image.beside(middle, across, down) else {
                continue;
            };
            // (a depth farther off than the reach needs no point)
            if (image.depth.data[pixel] - away).abs() > REACH * voxel {
                continue;
            }
            let Some((point, n)) = image.point(pixel).zip(image.normal(pixel)) else {
                continue;
            };
            let to = (point - metres) / voxel;
            let near = 1.0 - to.length_squared() / (REACH * REACH);
            // another side of a thin board faces away
            if near <= 0.0 || n.dot(normal) <= 0.0 {
                continue;
            }
            let squarely = n.dot(image.camera.position - point) / image.depth.data[pixel];
            let weight = f64::from(near * near * squarely);
            let (n, to) = (vector(n), vector(to));
            turns += n * n.transpose() * weight;
            offsets += n * n.dot(&to) * weight;
            whole += weight;
        }
    }
    if whole <= 0.0 {
        return None;
    }
    let turns = turns / whole;
    let mut spread = turns.symmetric_eigenvalues();
    spread.as_mut_slice().sort_by(f64::total_cmp);
    Some(Planes {
        turns,
        offsets: offsets / whole,
        bent: spread[1].max(0.0),
    })
}

fn vector(v: Vec3) -> Vector3<f64> {
    let DVec3 { x, y, z } = v.as_dvec3();
    Vector3::new(x, y, z)
}

impl Planes {
    /// How far a vertex moves to be nearest to the planes, in voxels: not at all where normals turn no more than
    /// twice as much as noise has them `scatter` (Stein's shrinkage), as the mean distance is better there.
    fn nearest(&self, scatter: f64) -> Option<Vec3> {
        let held = self.turns + Matrix3::identity() * scatter.max(LEAST_SCATTER);
        let certain = (1.0 - 2.0 * scatter / (self.bent + LEAST_SCATTER)).max(0.0);
        let shift = held.cholesky()?.solve(&self.offsets) * certain;
        let far = shift.amax();
        let shift = shift * (FARTHEST / far.max(FARTHEST));
        Some(DVec3::new(shift.x, shift.y, shift.z).as_vec3()).filter(|s| s.is_finite())
    }
}

#[cfg(test)]
mod tests {
    use super::super::surface_nets::{Sample, surface_net};
    use super::*;
    use crate::core::geometry::Camera;
    use crate::core::geometry::Projection;
    use crate::core::image::Plane;
    use crate::core::sampling::KeyedRng;
    use glam::{IVec3, Mat3, Quat};

    const VOXEL: f32 = 0.04;

    /// The walls that meet in the corner of a room, as unit normals into it, and how far inside a place is.
    struct Corner(Vec<Vec3>);

    impl Corner {
        fn inside(&self, place: Vec3) -> f32 {
            self.0
                .iter()
                .map(|n| n.dot(place))
                .fold(f32::INFINITY, f32::min)
        }

        /// A panorama's depth of it, each off by `noise` of it.
        fn image(&self, position: Vec3, noise: f32) -> RangeImage {
            let camera = Camera {
                position,
                world_from_camera: Mat3::IDENTITY,
                width: 256,
                height: 128,
                projection: Projection::Equirectangular,
            };
            let mut depth = Plane::filled(256, 128, 0.0);
            for (i, d) in depth.data.iter_mut().enumerate() {
                let pixel = glam::Vec2::new((i % 256) as f32 + 0.5, (i / 256) as f32 + 0.5);
                let ray = camera.direction(pixel);
                let reach = |n: &Vec3| n.dot(position) / -n.dot(ray);
                let nearest = self.0.iter().map(reach).filter(|t| *t > 0.0);
                *d = nearest.fold(f32::INFINITY, f32::min);
                // uniform, of standard deviation one
                let error = (KeyedRng::new(3, i as u64).next_f32() - 0.5) * 12.0f32.sqrt();
                *d *= 1.0 + noise * error;
            }
            RangeImage::new(camera, depth, 1.0)
        }

        /// Its surface within 60 cm, by its true distances.
        fn net(&self) -> Net {
            let all = -15..15;
            let places = all.clone().flat_map(|x| {
                all.clone()
                    .flat_map(move |y| (-15..15).map(move |z| IVec3::new(x, y, z)))
            });
            let known: Vec<IVec3> = places.collect();
            let sample = |p: IVec3| {
                let distance = self.inside(p.as_vec3());
                let inside = f32::from(distance < 0.0);
                Some(Sample { distance, inside })
            };
            surface_net(&known, sample)
        }
    }

    /// Walls that meet at right angles and turned against the grid: off their corner before, on it after,
    /// and no triangle cuts it.
    #[test]
    fn a_corner_of_a_room_is_sharp() {
        let turn = Mat3::from_quat(Quat::from_rotation_y(0.4) * Quat::from_rotation_x(0.3));
        let corner = Corner(vec![turn.x_axis, turn.y_axis, turn.z_axis]);
        let images = [
            turn * Vec3::new(1.1, 1.3, 0.9),
            turn * Vec3::new(0.7, 1.0, 1.4),
        ];
        let images = images.map(|p| corner.image(p, 0.0));
        let net = corner.net();
        let off = |places: &[Vec3]| {
            places
                .iter()
                .map(|p| corner.inside(*p).abs())
                .fold(0.0, f32::max)
        };
        assert!(off(&net.positions) > 0.2, "{}", off(&net.positions));
        let (places, triangles) = creased(&net, &images, VOXEL);
        let middle = |t: &[u32; 3]| t.iter().map(|i| places[*i as usize]).sum::<Vec3>() / 3.0;
        let middles: Vec<Vec3> = triangles.iter().map(middle).collect();
        assert!(off(&places) < 0.03, "{}", off(&places));
        assert!(off(&middles) < 0.1, "{}", off(&middles));
    }

    /// A wall through noise of 1 % of the depth stays as flat as the noise, averaged, leaves it.
    #[test]
    fn noise_is_no_crease() {
        let wall = Corner(vec![Vec3::new(0.1, 0.05, 1.0).normalize()]);
        let images =
            [Vec3::new(0.0, 0.2, 1.5), Vec3::new(0.3, -0.2, 1.2)].map(|p| wall.image(p, 0.01));
        let net = wall.net();
        let (places, triangles) = creased(&net, &images, VOXEL);
        let square =
            places.iter().map(|p| wall.inside(*p).powi(2)).sum::<f32>() / places.len() as f32;
        // 1 % of 1.4 m is a third of a voxel
        assert!(square.sqrt() < 0.2, "{}", square.sqrt());
        for t in triangles {
            let [a, b, c] = t.map(|i| places[i as usize]);
            assert!((b - a).cross(c - a).dot(wall.0[0]) > 0.0, "turned over");
        }
    }
}

//! Which side of each triangle faces the room.
//!
//! The winding of real meshes does not tell: shells are wound inside out, single triangles turned.
//! The views tell where they look, in proportion to how squarely; what they do not see follows its
//! shell ([`Shells`]). Where the evidence within a shell contradicts itself (a thin wall seen from
//! both of its rooms, a crack that shows the far side of a closed body), each triangle's side is the
//! sign of the x that minimises
//!
//!   Σₜ aₜ⁺ (xₜ − 1)² + aₜ⁻ (xₜ + 1)² + Σ over neighbours (xₜ − x_u)²
//!
//! with aₜ± the pixels, times cosine, that see either side: what is seen keeps the side that is
//! seen, the rest takes that of the nearest evidence, and a pixel through a crack does not outweigh
//! three neighbours (a random walk from t ends at evidence for one side or the other; Grady 2006,
//! "Random Walks for Image Segmentation", PAMI 28(11)). A shell that no view sees faces where its
//! rays meet seen surfaces from their seen sides. Called by the pipeline when it has traced the
//! views.

use super::ViewBuffer;
use crate::core::geometry::{Mesh, Shells};
use crate::core::math::Frame;
use crate::core::parallel::prelude::*;
use crate::core::sampling::{KeyedRng, square_to_cosine_hemisphere};
use crate::core::trace::{Hit, Ray, Tracer};
use glam::{Vec2, Vec3};

/// Rounds of conjugate gradients at most, and the residual, relative to the first, at which they
/// end. Derived: only signs are read, and the first rounds settle all but the far ends of large
/// unseen parts.
const ROUNDS: usize = 300;
const RESIDUAL: f64 = 1e-4;

/// Triangles of an unseen shell that are asked, and rays from either of their sides. Derived: 128
/// rays a side tell apart shares that differ by a tenth at two standard errors.
const ASKED: usize = 8;
const RAYS: usize = 16;
/// How much farther, relative, rays from the one side of a shell without views must reach than from
/// the other. Derived: two standard errors of means of 128 distances that scatter by half of themselves.
const APART: f32 = 0.12;

/// Which side of each triangle the cameras see: +1 along the winding's normal, −1 against it.
#[derive(Clone, Debug)]
pub struct Orientation {
    sign: Vec<i8>,
    /// Whether views look at some triangle of its shell.
    seen: Vec<bool>,
    /// Triangles that views see from both sides.
    two_sided: usize,
}

/// What the views see of a triangle: pixels times cosine, from the side of the winding's normal
/// and from the other.
#[derive(Clone, Copy, Debug, Default)]
struct Looks {
    front: f32,
    behind: f32,
}

impl Looks {
    fn any(&self) -> bool {
        self.front + self.behind > 0.0
    }
}

/// Where rays are shot to find out what a face looks at.
pub struct Probe<'a> {
    /// The mesh.
    pub mesh: &'a Mesh,
    /// Rays against it.
    pub tracer: &'a dyn Tracer,
    /// Distance from the surface at which rays start, metres.
    pub offset: f32,
    /// Distance up to which a hit counts as none, metres.
    pub beyond: f32,
}

impl Orientation {
    /// Lets the pixels of all views vote, shell by shell; shells nobody sees keep their winding.
    #[must_use]
    pub fn vote(mesh: &Mesh, buffers: &[&ViewBuffer]) -> Self {
        Self::agreed(mesh, buffers, &Shells::of(mesh))
    }

    /// As [`Self::vote`]; shells nobody sees face where rays from them meet what is seen.
    #[must_use]
    pub fn find(mesh: &Mesh, buffers: &[&ViewBuffer], tracer: &dyn Tracer, offset: f32) -> Self {
        let shells = Shells::of(mesh);
        let mut found = Self::agreed(mesh, buffers, &shells);
        let unseen: Vec<&[u32]> = shells
            .iter()
            .filter(|shell| !shell.iter().any(|&t| found.seen[t as usize]))
            .collect();
        let probe = Probe {
            mesh,
            tracer,
            offset,
            beyond: 0.0,
        };
        let turned: Vec<bool> = unseen
            .par_iter()
            .map(|shell| found.faces_away(&probe, &shells, shell))
            .collect();
        for (shell, turned) in unseen.into_iter().zip(turned) {
            for &t in shell {
                let sign = shells.parity(t) * if turned { -1.0 } else { 1.0 };
                found.sign[t as usize] = sign as i8;
            }
        }
        found
    }

    /// Without any view: a shell faces the side from which its rays go farther and still meet
    /// something. A wall looks into its room and not out of it, where nothing is met; a picture, a
    /// rug or a cupboard looks away from what lies close behind its faces. Where the sides hardly
    /// differ the winding counts.
    #[must_use]
    pub fn of_shape(mesh: &Mesh, tracer: &dyn Tracer, offset: f32) -> Self {
        let shells = Shells::of(mesh);
        let mut found = Self::of_winding(mesh.triangles.len());
        let probe = Probe {
            mesh,
            tracer,
            offset,
            beyond: 0.0,
        };
        let list: Vec<&[u32]> = shells.iter().collect();
        let faces: Vec<f32> = (list.par_iter())
            .map(|shell| {
                let mut reach = [0.0f32; 2];
                for t in largest(mesh, shell) {
                    let along = if shells.parity(t) > 0.0 { 0 } else { 1 };
                    reach[along] += probe.reach(t, 1.0, RAYS);
                    reach[1 - along] += probe.reach(t, -1.0, RAYS);
                }
                let [front, behind] = reach;
                if front < behind * (1.0 - APART) {
                    -1.0
                } else {
                    1.0
                }
            })
            .collect();
        for (shell, face) in list.into_iter().zip(faces) {
            for &t in shell {
                found.sign[t as usize] = (shells.parity(t) * face) as i8;
            }
        }
        found
    }

    fn agreed(mesh: &Mesh, buffers: &[&ViewBuffer], shells: &Shells) -> Self {
        let looks = looks_of(mesh, buffers);
        let mut sign = vec![1i8; mesh.triangles.len()];
        for shell in shells.iter() {
            agree(shells, shell, &looks, &mut sign);
        }
        let mut seen = vec![false; sign.len()];
        for shell in shells.iter() {
            let any = shell.iter().any(|&t| looks[t as usize].any());
            shell.iter().for_each(|&t| seen[t as usize] = any);
        }
        Self {
            sign,
            seen,
            two_sided: looks
                .iter()
                .filter(|l| l.front > 0.0 && l.behind > 0.0)
                .count(),
        }
    }

    /// Whether a shell that no view sees faces against the winding of its first triangle: whether
    /// more rays from there than from the other side meet surfaces from the side that is seen.
    fn faces_away(&self, probe: &Probe, shells: &Shells, shell: &[u32]) -> bool {
        let balance = |&t: &u32| {
            let [front, behind] = [1.0, -1.0].map(|side| self.open_share(probe, t, side, RAYS));
            (front - behind) * shells.parity(t)
        };
        let asked = largest(probe.mesh, shell);
        asked.iter().map(balance).sum::<f32>() < 0.0
    }

    /// Share of `rays` cosine-distributed rays from the middle of triangle `t`, on the side of its
    /// winding's normal for `side` 1 and on the other for −1, that meet a seen surface from the
    /// side that is seen, farther off than `probe.beyond`. None does from a face that is shut in.
    #[must_use]
    pub fn open_share(&self, probe: &Probe, t: u32, side: f32, rays: usize) -> f32 {
        let rays = probe.rays(t, side, rays);
        let mut hits = vec![Hit::miss(); rays.len()];
        probe.tracer.closest(&rays, &mut hits);
        let open = |(r, h): &(&Ray, &Hit)| {
            let t = h.triangle as usize;
            h.is_hit() && h.t > probe.beyond && self.seen[t] && {
                let n = probe.mesh.face_normal(t) * self.sign(t);
                n.dot(Vec3::from_array(r.direction)) < 0.0
            }
        };
        let open = rays.iter().zip(&hits).filter(open).count();
        open as f32 / rays.len().max(1) as f32
    }

    /// The winding's own orientation for `triangles` triangles.
    #[must_use]
    pub fn of_winding(triangles: usize) -> Self {
        Self {
            sign: vec![1; triangles],
            seen: vec![false; triangles],
            two_sided: 0,
        }
    }

    /// +1 or −1 for triangle `t`.
    #[must_use]
    pub fn sign(&self, t: usize) -> f32 {
        f32::from(self.sign[t])
    }

    /// Number of triangles that face against their winding.
    #[must_use]
    pub fn flipped(&self) -> usize {
        self.sign.iter().filter(|s| **s < 0).count()
    }

    /// Number of triangles that views see from both sides.
    #[must_use]
    pub fn two_sided(&self) -> usize {
        self.two_sided
    }
}

/// The triangles of a shell that are asked: its largest.
fn largest(mesh: &Mesh, shell: &[u32]) -> Vec<u32> {
    let mut order = shell.to_vec();
    order.sort_by(|a, b| {
        let area = |t: &u32| mesh.area(*t as usize);
        area(b).total_cmp(&area(a)).then(a.cmp(b))
    });
    order.truncate(ASKED);
    order
}

/// Pixels times cosine that see each triangle from either side; pixels count by their solid angle
/// against the largest of their view.
fn looks_of(mesh: &Mesh, buffers: &[&ViewBuffer]) -> Vec<Looks> {
    let mut looks = vec![Looks::default(); mesh.triangles.len()];
    for b in buffers {
        let (w, h) = (b.triangle.width, b.triangle.height);
        let solid_angle = |y: usize| {
            b.camera
                .pixel_solid_angle(Vec2::new(0.5 * w as f32, y as f32 + 0.5))
        };
        let largest = (0..h).map(solid_angle).fold(f32::MIN_POSITIVE, f32::max);
        let size: Vec<f32> = (0..h).map(|y| solid_angle(y) / largest).collect();
        let along_winding = |t: usize, (x, y): (usize, usize)| {
            Some(size[y] * -mesh.face_normal(t).dot(b.direction(x, y)))
        };
        for (t, look) in b.told_by_pixels(along_winding) {
            if look > 0.0 {
                looks[t].front += look;
            } else {
                looks[t].behind -= look;
            }
        }
    }
    looks
}

/// Settles the sides of one shell. Without evidence its triangles keep their windings.
fn agree(shells: &Shells, shell: &[u32], looks: &[Looks], sign: &mut [i8]) {
    // looks along and against the first triangle's winding
    let of = |t: u32| {
        let l = looks[t as usize];
        if shells.parity(t) > 0.0 {
            [l.front, l.behind].map(f64::from)
        } else {
            [l.behind, l.front].map(f64::from)
        }
    };
    let [along, against] = shell.iter().fold([0.0; 2], |s, &t| {
        let [a, b] = of(t);
        [s[0] + a, s[1] + b]
    });
    if along == 0.0 && against == 0.0 {
        return;
    }
    let side = if along >= against { 1.0 } else { -1.0 };
    let consistent = shell.iter().all(|&t| {
        let [a, b] = of(t);
        (a - b) * side >= 0.0
    });
    let sides = if consistent {
        vec![side; shell.len()]
    } else {
        let evidence: Vec<[f64; 2]> = shell.iter().map(|&t| of(t)).collect();
        walk(shells, shell, &evidence)
    };
    for (&t, x) in shell.iter().zip(sides) {
        let x = if x == 0.0 { side } else { x };
        sign[t as usize] = (x.signum() * f64::from(shells.parity(t))) as i8;
    }
}

/// The x of the file's head for the triangles of one shell, by conjugate gradients with the
/// diagonal as preconditioner.
fn walk(shells: &Shells, shell: &[u32], evidence: &[[f64; 2]]) -> Vec<f64> {
    let mut order: Vec<(u32, u32)> = shell.iter().copied().zip(0..).collect();
    order.sort_unstable();
    let local = |t: u32| {
        let at = order.binary_search_by_key(&t, |o| o.0);
        at.map_or(0, |i| order[i].1 as usize)
    };
    let links: Vec<Vec<(usize, f64)>> = shell
        .iter()
        .map(|&t| {
            let relative = |n: &crate::core::geometry::Neighbour| {
                // −1 only where no winding agrees all around
                let consistent = shells.parity(t) * shells.parity(n.triangle);
                let alike = if n.alike { 1.0 } else { -1.0 };
                (local(n.triangle), f64::from(consistent * alike))
            };
            shells.neighbours(t).iter().map(relative).collect()
        })
        .collect();
    let diagonal: Vec<f64> = evidence
        .iter()
        .zip(&links)
        .map(|([a, b], l)| a + b + l.len() as f64)
        .collect();
    let apply = |x: &[f64]| -> Vec<f64> {
        let row =
            |i: usize| diagonal[i] * x[i] - links[i].iter().map(|(j, p)| p * x[*j]).sum::<f64>();
        (0..x.len()).map(row).collect()
    };
    let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
    let precondition = |r: &[f64]| -> Vec<f64> {
        r.iter()
            .zip(&diagonal)
            .map(|(r, d)| r / d.max(f64::MIN_POSITIVE))
            .collect()
    };
    let mut x = vec![0.0; shell.len()];
    let mut r: Vec<f64> = evidence.iter().map(|[a, b]| a - b).collect();
    let mut z = precondition(&r);
    let mut p = z.clone();
    let mut rz = dot(&r, &z);
    let enough = rz * RESIDUAL * RESIDUAL;
    for _ in 0..ROUNDS {
        let ap = apply(&p);
        let step = rz / dot(&p, &ap);
        if !step.is_finite() {
            break;
        }
        for i in 0..x.len() {
            x[i] += step * p[i];
            r[i] -= step * ap[i];
        }
        z = precondition(&r);
        let next = dot(&r, &z);
        if next <= enough {
            break;
        }
        for i in 0..p.len() {
            p[i] = z[i] + next / rz * p[i];
        }
        rz = next;
    }
    x
}

impl Probe<'_> {
    /// Mean distance that `count` cosine-distributed rays from a side of triangle `t` go until they
    /// meet surface, metres; 0 for those that meet none.
    #[must_use]
    pub fn reach(&self, t: u32, side: f32, count: usize) -> f32 {
        let rays = self.rays(t, side, count);
        let mut hits = vec![Hit::miss(); rays.len()];
        self.tracer.closest(&rays, &mut hits);
        let distance = |h: &Hit| if h.is_hit() { h.t } else { 0.0 };
        hits.iter().map(distance).sum::<f32>() / rays.len().max(1) as f32
    }

    /// Rays from the middle of a triangle on one of its sides.
    fn rays(&self, t: u32, side: f32, count: usize) -> Vec<Ray> {
        let up = self.mesh.face_normal(t as usize) * side;
        let origin = self.mesh.position(t as usize, 1.0 / 3.0, 1.0 / 3.0) + up * self.offset;
        let frame = Frame::from_normal(up);
        let mut rng = KeyedRng::new(0x0517, t.into());
        (0..count)
            .map(|_| {
                let d = square_to_cosine_hemisphere([rng.next_f32(), rng.next_f32()]);
                Ray::new(origin, frame.world_from_local(d), f32::INFINITY)
            })
            .collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::core::geometry::{Camera, Projection};
    use crate::core::trace::BruteForce;
    use glam::Mat3;

    /// Quads of the box [0, size] with normals inwards, each cut into n × n squares of two
    /// triangles.
    fn room(corner: Vec3, size: Vec3, n: usize) -> Mesh {
        let [x, y, z] = [Vec3::X * size.x, Vec3::Y * size.y, Vec3::Z * size.z];
        let walls = [
            (Vec3::ZERO, z, x),
            (y, x, z),
            (Vec3::ZERO, y, z),
            (x, z, y),
            (Vec3::ZERO, x, y),
            (z, y, x),
        ];
        let mut mesh = Mesh::default();
        for (o, u, v) in walls {
            for k in 0..n * n {
                let (i, j) = ((k % n) as f32, (k / n) as f32);
                let first = mesh.positions.len() as u32;
                for (a, b) in [(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)] {
                    let (a, b) = ((i + a) / n as f32, (j + b) / n as f32);
                    mesh.positions.push(corner + o + u * a + v * b);
                }
                mesh.triangles
                    .extend([[first, first + 1, first + 2], [first, first + 2, first + 3]]);
            }
        }
        mesh
    }

    fn append(mesh: &mut Mesh, other: &Mesh) {
        let first = mesh.positions.len() as u32;
        mesh.positions.extend(&other.positions);
        mesh.triangles
            .extend(other.triangles.iter().map(|t| t.map(|i| i + first)));
    }

    fn panorama(position: Vec3, mesh: &Mesh, width: usize) -> ViewBuffer {
        let camera = Camera {
            projection: Projection::Equirectangular,
            width,
            height: width / 2,
            world_from_camera: Mat3::IDENTITY,
            position,
        };
        ViewBuffer::trace(&camera, &BruteForce::new(mesh))
    }

    /// Turns the triangles that `turned` picks and says which way each should be found.
    fn wound(mesh: &Mesh, turned: impl Fn(usize) -> bool) -> (Mesh, Vec<f32>) {
        let mut mesh = mesh.clone();
        let mut want = Vec::new();
        for t in 0..mesh.triangles.len() {
            if turned(t) {
                mesh.triangles[t].swap(1, 2);
            }
            want.push(if turned(t) { -1.0 } else { 1.0 });
        }
        (mesh, want)
    }

    #[test]
    fn triangles_smaller_than_a_pixel_follow_their_shell_whatever_their_winding() {
        let mesh = room(Vec3::ZERO, Vec3::new(4.0, 3.0, 5.0), 12);
        for turned in [
            (|_| false) as fn(usize) -> bool,
            |_| true,
            |t| t.wrapping_mul(2_654_435_761) >> 7 & 1 == 1,
        ] {
            let (mesh, want) = wound(&mesh, turned);
            // 288 pixels for 1,728 triangles: most are seen by none
            let buffer = panorama(Vec3::new(1.0, 1.5, 2.0), &mesh, 24);
            let found = Orientation::vote(&mesh, &[&buffer]);
            let looks = looks_of(&mesh, &[&buffer]);
            assert!(looks.iter().filter(|l| !l.any()).count() > 1000);
            let signs: Vec<f32> = (0..want.len()).map(|t| found.sign(t)).collect();
            assert_eq!(signs, want);
            assert_eq!(found.two_sided(), 0);
        }
    }

    #[test]
    fn an_unseen_body_faces_the_seen_room() {
        // a cupboard stands behind a screen; its back and bottom are open to rays as all is
        let mut mesh = room(Vec3::ZERO, Vec3::new(4.0, 3.0, 5.0), 4);
        let walls = mesh.triangles.len();
        let screen = room(Vec3::new(0.5, 0.0, 1.0), Vec3::new(3.0, 2.9, 0.01), 2);
        append(&mut mesh, &screen);
        let screened = mesh.triangles.len();
        let cupboard = room(Vec3::new(1.8, 0.8, 0.4), Vec3::splat(0.3), 1);
        append(&mut mesh, &cupboard);
        for flip in [false, true] {
            let (mesh, _) = wound(&mesh, |t| flip && t % 3 == 0);
            let tracer = BruteForce::new(&mesh);
            let buffer = panorama(Vec3::new(2.0, 1.5, 3.5), &mesh, 64);
            let found = Orientation::find(&mesh, &[&buffer], &tracer, 1e-4);
            assert!(!found.seen[screened..].iter().any(|s| *s));
            for t in 0..mesh.triangles.len() {
                let turned = if flip && t % 3 == 0 { -1.0 } else { 1.0 };
                // boxes in the room face outwards, against their winding here
                let want = if t < walls { turned } else { -turned };
                assert_eq!(found.sign(t), want, "triangle {t}");
            }
        }
    }

    /// Without views a room's walls look in, furniture looks out and a rug looks up, however they
    /// are wound.
    #[test]
    fn a_scan_faces_where_its_rays_go_far() {
        let mut mesh = room(Vec3::ZERO, Vec3::new(4.0, 3.0, 5.0), 2);
        let walls = mesh.triangles.len();
        append(
            &mut mesh,
            &room(Vec3::new(1.8, 0.0, 0.4), Vec3::new(0.6, 1.0, 0.6), 2),
        );
        append(
            &mut mesh,
            &room(Vec3::new(1.0, 1e-3, 2.0), Vec3::new(2.0, 0.01, 1.0), 1),
        );
        for turn in [(|_| false) as fn(usize) -> bool, |_| true, |t| t % 3 == 0] {
            let (mesh, want) = wound(&mesh, turn);
            let found = Orientation::of_shape(&mesh, &BruteForce::new(&mesh), 1e-4);
            for (t, want) in want.iter().enumerate() {
                // boxes in the room face outwards, against their winding here
                let want = if t < walls { *want } else { -want };
                assert_eq!(found.sign(t), want, "triangle {t}");
            }
        }
    }

    #[test]
    fn a_thin_wall_between_two_rooms_keeps_the_side_that_sees_each_part() {
        // one sheet 8 m long; one camera before its left half, another behind its right half, each
        // shut off from the other half
        let mut sheet = Mesh::default();
        for i in 0..16 {
            let first = sheet.positions.len() as u32;
            for (dx, y) in [(0.0, 0.0), (0.5, 0.0), (0.5, 3.0), (0.0, 3.0)] {
                let x = 0.5 * i as f32 + dx;
                sheet.positions.push(Vec3::new(x, y, 0.0));
            }
            sheet
                .triangles
                .extend([[first, first + 1, first + 2], [first, first + 2, first + 3]]);
        }
        let n = sheet.triangles.len();
        let mut mesh = sheet;
        append(
            &mut mesh,
            &room(Vec3::new(-0.1, -0.1, 0.3), Vec3::new(4.0, 3.2, 3.0), 1),
        );
        append(
            &mut mesh,
            &room(Vec3::new(4.1, -0.1, -3.3), Vec3::new(4.0, 3.2, 3.0), 1),
        );
        // the walls of the boxes towards the sheet are left away
        let keep = |t: &[u32; 3], mesh: &Mesh| {
            let z: Vec<f32> = t.iter().map(|&i| mesh.positions[i as usize].z).collect();
            !z.iter().all(|z| (z.abs() - 0.3).abs() < 1e-4)
        };
        let all = std::mem::take(&mut mesh.triangles);
        mesh.triangles = all.into_iter().filter(|t| keep(t, &mesh)).collect();
        let views = [
            panorama(Vec3::new(2.0, 1.5, 1.5), &mesh, 128),
            panorama(Vec3::new(6.0, 1.5, -1.5), &mesh, 128),
        ];
        let found = Orientation::vote(&mesh, &[&views[0], &views[1]]);
        for t in 0..n {
            let x = mesh.corners(t).iter().map(|p| p.x).sum::<f32>() / 3.0;
            if (x - 4.0).abs() > 1.0 {
                assert_eq!(
                    found.sign(t),
                    if x < 4.0 { 1.0 } else { -1.0 },
                    "at x = {x}"
                );
            }
        }
    }

    #[test]
    fn a_pixel_through_a_crack_does_not_turn_a_face() {
        let mesh = room(Vec3::ZERO, Vec3::ONE, 3);
        let shells = Shells::of(&mesh);
        let mut looks = vec![
            Looks {
                front: 40.0,
                behind: 0.0
            };
            mesh.triangles.len()
        ];
        looks[7] = Looks {
            front: 0.0,
            behind: 1.0,
        };
        let mut sign = vec![1; looks.len()];
        for shell in shells.iter() {
            agree(&shells, shell, &looks, &mut sign);
        }
        assert!(sign.iter().all(|s| *s == 1));
        // twenty pixels are no accident
        looks[7].behind = 20.0;
        for shell in shells.iter() {
            agree(&shells, shell, &looks, &mut sign);
        }
        assert_eq!(sign.iter().filter(|s| **s < 0).count(), 1);
        assert_eq!(sign[7], -1);
    }
}

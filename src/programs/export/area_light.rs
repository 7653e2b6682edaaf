//! Lamps as simple luminous shapes: a rectangle, a disk or a sphere, whichever a lamp resembles.
//!
//! The shape has the lamp's area and the lamp's mean radiance L, so that it sends out the lamp's
//! power Φ = π · L · area ([`Lamp::power`]). A lamp is flat where its triangles face one way: then
//! the length of the vector area ∫ n dA is its area; of a closed surface it is 0.

use crate::solution::{Lamp, Solution, lamp_gap};
use glam::{DVec3, Mat3, Vec2, Vec3};
use std::f32::consts::PI;

/// Vector area over area from which a lamp is flat (derived: halfway between a hemisphere, 1/2, and
/// a plane, 1).
const FLAT: f32 = 0.75;
/// Share of its bounding rectangle below which a flat lamp is no rectangle (derived: halfway between
/// a disk, π/4, and a rectangle, 1).
const FULL: f32 = 0.5 * (1.0 + 0.25 * PI);
/// Sides' ratio up to which it is a disk then (derived: halfway, in logarithms, between a circle and
/// something twice as long).
const ROUND: f32 = std::f32::consts::SQRT_2;

/// What a lamp resembles.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum LightShape {
    /// Shines to one side; width along x, height along y, metres.
    Rectangle([f32; 2]),
    /// Shines to one side; radius, metres.
    Disk(f32),
    /// Shines outwards; radius, metres.
    Sphere(f32),
}

impl LightShape {
    /// The luminous area, m².
    #[must_use]
    pub fn area(&self) -> f32 {
        match *self {
            Self::Rectangle([width, height]) => width * height,
            Self::Disk(radius) => PI * radius * radius,
            Self::Sphere(radius) => 4.0 * PI * radius * radius,
        }
    }
}

/// A lamp as a luminous shape.
#[derive(Clone, Debug, PartialEq)]
pub struct AreaLight {
    /// Kind and number of the lamp.
    pub name: String,
    /// What it resembles.
    pub shape: LightShape,
    /// Emitted radiance.
    pub radiance: Vec3,
    /// Centre, relative to the solution's origin; that of a flat lamp lies a little in front of its
    /// surface, so that the surface does not hide it.
    pub position: DVec3,
    /// World axes of the shape: a flat one lies in the plane of x and y and shines along −z.
    pub axes: Mat3,
}

/// The lamps of a solution, in its order.
#[must_use]
pub fn area_lights(solution: &Solution) -> Vec<AreaLight> {
    let bright = |l: &&Lamp| l.area > 0.0 && l.radiance.iter().any(|c| *c > 0.0);
    solution
        .lamps
        .iter()
        .filter(bright)
        .map(|lamp| area_light(solution, lamp))
        .collect()
}

fn area_light(solution: &Solution, lamp: &Lamp) -> AreaLight {
    let mesh = &solution.mesh;
    let vector_area: Vec3 = lamp
        .triangles
        .iter()
        .map(|&t| 0.5 * mesh.double_area_normal(t as usize))
        .sum();
    let centre = DVec3::from_array(lamp.centre) - solution.origin;
    let light = |shape: LightShape, position: DVec3, axes: Mat3| AreaLight {
        name: format!("{} {}", lamp.kind, lamp.id),
        shape,
        radiance: Vec3::from_array(lamp.radiance),
        position,
        axes,
    };
    if vector_area.length() <= FLAT * lamp.area {
        let radius = (lamp.area / (4.0 * PI)).sqrt();
        return light(LightShape::Sphere(radius), centre, Mat3::IDENTITY);
    }
    let normal = vector_area.normalize();
    let corners = lamp
        .triangles
        .iter()
        .flat_map(|&t| mesh.corners(t as usize));
    let rectangle = bounding_rectangle(corners, normal);
    let [width, height] = rectangle.size;
    let full = lamp.area / (width * height).max(f32::MIN_POSITIVE);
    let long = width.max(height) / width.min(height).max(f32::MIN_POSITIVE);
    let shape = if full < FULL && long < ROUND {
        LightShape::Disk((lamp.area / PI).sqrt())
    } else {
        // what does not fill its rectangle becomes a smaller one of the same sides
        LightShape::Rectangle(rectangle.size.map(|s| s * full.sqrt()))
    };
    let front = 0.5 * f64::from(lamp_gap(mesh)) * normal.as_dvec3();
    light(shape, centre + front, rectangle.axes)
}

/// A rectangle in a plane.
struct BoundingRectangle {
    size: [f32; 2],
    /// x along the width, y along the height, −z the plane's normal.
    axes: Mat3,
}

/// The smallest rectangle around points as they are seen along `normal`: one of its sides lies on a
/// side of their convex hull (Freeman & Shapira 1975).
fn bounding_rectangle(points: impl Iterator<Item = Vec3>, normal: Vec3) -> BoundingRectangle {
    let x = Vec3::Y.cross(normal).try_normalize().unwrap_or(Vec3::X);
    let y = normal.cross(x);
    let hull = convex_hull(points.map(|p| Vec2::new(p.dot(x), p.dot(y))).collect());
    let sides = (0..hull.len()).map(|i| hull[(i + 1) % hull.len()] - hull[i]);
    let around = |side: Vec2| {
        let direction = side.try_normalize()?;
        let extent = |d: Vec2| {
            let (low, high) = hull
                .iter()
                .fold((f32::INFINITY, f32::NEG_INFINITY), |b, p| {
                    (b.0.min(p.dot(d)), b.1.max(p.dot(d)))
                });
            high - low
        };
        Some((direction, [extent(direction), extent(direction.perp())]))
    };
    let (direction, size) = sides
        .filter_map(around)
        .min_by(|a, b| (a.1[0] * a.1[1]).total_cmp(&(b.1[0] * b.1[1])))
        .unwrap_or((Vec2::X, [0.0; 2]));
    let along = x * direction.x + y * direction.y;
    BoundingRectangle {
        size,
        axes: Mat3::from_cols(along, along.cross(normal), -normal),
    }
}

/// The convex hull, counter-clockwise (Andrew 1979).
fn convex_hull(mut points: Vec<Vec2>) -> Vec<Vec2> {
    points.sort_by(|a, b| a.x.total_cmp(&b.x).then(a.y.total_cmp(&b.y)));
    points.dedup();
    let chain = |points: &mut dyn Iterator<Item = Vec2>| {
        let mut out: Vec<Vec2> = Vec::new();
        for p in points {
            while let [.., a, b] = out[..]
                && (b - a).perp_dot(p - b) <= 0.0
            {
                out.pop();
            }
            out.push(p);
        }
        out.pop();
        out
    };
    let mut hull = chain(&mut points.iter().copied());
    hull.extend(chain(&mut points.iter().rev().copied()));
    hull
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use crate::core::geometry::Mesh;
    use crate::solution::find_lamps;
    use crate::solution::tests::small_solution;

    /// A solution of one lamp that is a fan of triangles around the first corner.
    pub(in crate::programs::export) fn fan(corners: &[Vec3]) -> Solution {
        let n = corners.len();
        let mut mesh = Mesh {
            positions: corners.to_vec(),
            normals: vec![Vec3::Y; n],
            uvs: vec![Vec2::splat(0.5); n],
            triangles: (2..n as u32).map(|i| [0, i - 1, i]).collect(),
        };
        // something that is no lamp makes the scene larger than its lamp
        mesh.positions.extend([Vec3::splat(-4.0), Vec3::splat(4.0)]);
        mesh.normals.extend([Vec3::Y; 2]);
        mesh.uvs.extend([Vec2::ZERO; 2]);
        solution_of(mesh)
    }

    fn solution_of(mesh: Mesh) -> Solution {
        let mut solution = small_solution();
        solution.mesh = mesh;
        solution.emission.data.fill(Vec3::new(8.0, 4.0, 2.0));
        solution.lamps = find_lamps(&solution.mesh, &solution.emission, solution.origin);
        solution
    }

    fn only(solution: &Solution) -> AreaLight {
        let lights = area_lights(solution);
        assert_eq!(lights.len(), 1);
        let (light, lamp) = (&lights[0], &solution.lamps[0]);
        let power = PI * light.shape.area() * light.radiance;
        let wrong = (power / Vec3::from_array(lamp.power) - 1.0).abs();
        assert!(wrong.max_element() < 1e-5, "{light:?} {:?}", lamp.power);
        light.clone()
    }

    #[test]
    fn a_turned_panel_is_a_rectangle_that_shines_where_it_faces() {
        let turn = Mat3::from_rotation_y(0.4) * Mat3::from_rotation_x(2.0);
        let corners = [(-0.6, -0.2), (0.6, -0.2), (0.6, 0.2), (-0.6, 0.2)]
            .map(|(x, y)| turn * Vec3::new(x, y, 0.3));
        let light = only(&fan(&corners));
        let LightShape::Rectangle(mut size) = light.shape else {
            panic!("{light:?}")
        };
        size.sort_by(f32::total_cmp);
        assert!(
            (size[0] - 0.4).abs() < 1e-4 && (size[1] - 1.2).abs() < 1e-4,
            "{size:?}"
        );
        let shines = -light.axes.z_axis;
        assert!((shines - turn * Vec3::Z).length() < 1e-5, "{shines}");
        assert!((light.axes.determinant() - 1.0).abs() < 1e-5, "no mirror");
        let along = (light.axes.x_axis.dot(turn * Vec3::X)).abs();
        assert!((along - 1.0).abs() < 1e-4 || along < 1e-4, "{along}");
        let off = (light.position.as_vec3() - turn * Vec3::new(0.0, 0.0, 0.3)).dot(shines);
        assert!(off > 0.0 && off < 0.02, "a little in front: {off}");
    }

    #[test]
    fn a_round_panel_is_a_disk_and_an_oval_one_no_disk() {
        let oval = |long: f32| {
            let corner = |i: usize| {
                let (s, c) = (i as f32 * PI / 24.0).sin_cos();
                Vec3::new(0.3 * long * s, 0.0, 0.3 * c)
            };
            only(&fan(&(0..48).map(corner).collect::<Vec<_>>()))
        };
        let LightShape::Disk(radius) = oval(1.0).shape else {
            panic!("{:?}", oval(1.0))
        };
        assert!((radius - 0.3).abs() < 2e-3, "{radius}");
        assert!(matches!(oval(2.0).shape, LightShape::Rectangle(_)));
    }

    #[test]
    fn a_bulb_is_a_sphere_of_its_power() {
        let mut mesh = Mesh::default();
        let corners = [Vec3::X, Vec3::Y, Vec3::Z, -Vec3::X, -Vec3::Y, -Vec3::Z];
        mesh.positions = corners.map(|c| 0.05 * c).to_vec();
        mesh.normals = corners.to_vec();
        mesh.uvs = vec![Vec2::splat(0.5); 6];
        mesh.triangles = vec![
            [0, 1, 2],
            [1, 3, 2],
            [3, 4, 2],
            [4, 0, 2],
            [1, 0, 5],
            [3, 1, 5],
            [4, 3, 5],
            [0, 4, 5],
        ];
        let light = only(&solution_of(mesh));
        assert!(matches!(light.shape, LightShape::Sphere(r) if r > 0.03 && r < 0.05));
        assert!(light.position.length() < 1e-4);
    }

    #[test]
    fn the_smallest_rectangle_lies_on_a_side_of_the_hull() {
        let square = [Vec2::ZERO, Vec2::X, Vec2::ONE, Vec2::Y, Vec2::splat(0.5)];
        assert_eq!(convex_hull(square.to_vec()).len(), 4);
        let turn = Vec2::from_angle(0.3);
        let points = square.map(|p| (turn.rotate(p) * Vec2::new(1.0, 1.0)).extend(0.7));
        let size = bounding_rectangle(points.into_iter(), Vec3::Z).size;
        assert!(size.iter().all(|s| (s - 1.0).abs() < 1e-5), "{size:?}");
        let none = bounding_rectangle(std::iter::empty(), Vec3::Z);
        assert_eq!(none.size, [0.0; 2]);
    }
}

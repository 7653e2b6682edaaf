//! Irradiance below a lamp, beside its closed form: `cargo run --release --example
//! bake_irradiance`.
//!
//! A square lamp of side 1 m and radiance 1 hangs 1 m above a point and shines down. For X = Y =
//! side / (2·height) = 1/2 its four quarters send E = 4·X/√(1+X²)·atan(X/√(1+X²)) = 0.7523 (form
//! factor of a parallel rectangle).

use glam::{Vec2, Vec3};
use unbake::core::brdf::Material;
use unbake::core::trace::EmbreeTracer;
use unbake::render::{BlackEnvironment, IrradiancePoint, Surface, SurfaceModel};
use unbake::{Mesh, PathTracer, PathTracerOptions, Progress};

/// One shining square.
struct Lamp;

impl SurfaceModel for Lamp {
    fn surface(&self, _: usize, _: f32, _: f32) -> Surface {
        let material = Material {
            albedo: Vec3::ZERO,
            roughness: 1.0,
        };
        Surface::dielectric(material, Vec3::ONE)
    }

    fn mean_emission(&self, _: usize) -> Vec3 {
        Vec3::ONE
    }

    fn label(&self, _: usize) -> u16 {
        0
    }
}

fn main() -> unbake::Result<()> {
    let corner = |x: f32, z: f32| Vec3::new(x, 1.0, z);
    let mesh = Mesh {
        positions: vec![
            corner(-0.5, -0.5),
            corner(0.5, -0.5),
            corner(0.5, 0.5),
            corner(-0.5, 0.5),
        ],
        normals: vec![Vec3::NEG_Y; 4],
        uvs: vec![Vec2::ZERO, Vec2::X, Vec2::ONE, Vec2::Y],
        triangles: vec![[0, 1, 2], [0, 2, 3]],
    };
    let embree = EmbreeTracer::new(&mesh)?;
    let options = PathTracerOptions::default();
    let tracer = PathTracer::new(&mesh, &embree, &Lamp, &BlackEnvironment, options);
    let point = IrradiancePoint {
        position: Vec3::ZERO,
        face_normal: Vec3::Y,
        normal: Vec3::Y,
    };
    let baked = tracer.irradiance(&[point], 4096, 0, &Progress::silent());
    let x = 0.5f32;
    let t = x / (1.0 + x * x).sqrt();
    println!(
        "irradiance {:.4}, closed form {:.4}",
        baked[0].x,
        4.0 * t * t.atan()
    );
    Ok(())
}

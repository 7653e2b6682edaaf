//! A panorama of a result with its brightest lamp off and the others warmer:
//! `cargo run --release --example relight OUT X Y Z PICTURE.exr` (X Y Z: camera, metres).

use glam::{DVec3, Mat3};
use unbake::core::formats::write_rgb_float;
use unbake::core::trace::EmbreeTracer;
use unbake::render::LampChange;
use unbake::{
    Camera, EditableScene, Lighting, PathTracer, PathTracerOptions, Progress, Projection, Solution,
};

fn main() -> unbake::Result<()> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [out, x, y, z, picture] = &arguments[..] else {
        return Err(unbake::Error::Usage("relight OUT X Y Z PICTURE".into()));
    };
    let number = |text: &str| {
        text.parse::<f64>()
            .map_err(|e| unbake::Error::Usage(format!("{text}: {e}")))
    };
    let place = DVec3::new(number(x)?, number(y)?, number(z)?);

    let solution = Solution::load(out.as_ref())?;
    let mut world = EditableScene::new(&solution);
    let lamps = &solution.lamps;
    let change = Lighting {
        lamps: vec![
            LampChange {
                colour: Some([1.0, 0.8, 0.6]),
                ..LampChange::default()
            },
            LampChange {
                group: lamps.first().map(|l| l.id),
                off: !lamps.is_empty(),
                ..LampChange::default()
            },
        ],
        ..Lighting::default()
    };
    change.apply(&mut world, lamps)?;

    let embree = EmbreeTracer::new(world.mesh())?;
    let options = PathTracerOptions::default();
    let tracer = PathTracer::new(world.mesh(), &embree, &world, &world, options);
    let camera = Camera {
        projection: Projection::Equirectangular,
        width: 256,
        height: 128,
        world_from_camera: Mat3::IDENTITY,
        position: (place - solution.origin).as_vec3(),
    };
    let frame = tracer.render(&camera, 0, &Progress::silent());
    write_rgb_float(picture, &frame.radiance())
}

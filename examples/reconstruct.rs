//! Takes the light out of a scene: `cargo run --release --example reconstruct SCENE OUT`.

use std::time::Instant;
use unbake::{LoadOptions, Progress, Quality, SaveOptions, Scene, SolveRequest, reconstruct};

fn main() -> unbake::Result<()> {
    let mut arguments = std::env::args().skip(1);
    let (Some(scene), Some(out)) = (arguments.next(), arguments.next()) else {
        return Err(unbake::Error::Usage("reconstruct SCENE OUT".into()));
    };
    let scene = Scene::load(scene, &LoadOptions::default())?;
    let request = SolveRequest {
        quality: Quality::Draft,
        ..SolveRequest::default()
    };
    let options = request.options(0, Instant::now());
    let solution = reconstruct(&scene, &options, &Progress::silent())?.solution;
    let (width, height) = (solution.albedo.width, solution.albedo.height);
    println!("albedo {width}x{height}");
    solution.save(out.as_ref(), &SaveOptions::default())?;
    Ok(())
}

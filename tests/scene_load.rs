//! The shared scenes load, and their pixels agree with what their headers and classes say.

mod shared;

use shared::shared;
use unbake::scene::{LoadOptions, Scene};

#[test]
fn shared_scenes_load() {
    for (name, train, test, triangles) in [
        ("grey-white-room", 16, 6, 131_811),
        ("grey-white-room-exact", 16, 6, 131_811),
        ("aws-house", 26, 6, 127_601),
    ] {
        let Some(path) = shared(format!("scenes/{name}")) else {
            continue;
        };
        let scene = Scene::load(&path, &LoadOptions::default()).expect("loads");
        assert_eq!(
            (scene.train_views().count(), scene.test_views().count()),
            (train, test)
        );
        assert_eq!(
            scene.mesh.triangles.len() + scene.mesh_stats.degenerate,
            triangles
        );
        let (lo, hi) = scene.mesh.bounds();
        assert!(
            (lo + hi).length() < 1e-4,
            "the origin is the centre of the bounds"
        );
        assert_eq!(scene.mesh_stats.overlapping_texels, 0);
        let view = scene.train_views().next().expect("a view");
        let (image, stats) = scene.load_radiance_with_stats(view).expect("pixels");
        assert_eq!(
            (image.width, image.height),
            (view.camera.width, view.camera.height)
        );
        assert_eq!(stats.not_finite, 0);
        let mean = image
            .data
            .iter()
            .map(|p| f64::from(p.element_sum()))
            .sum::<f64>()
            / (3 * image.data.len()) as f64;
        assert!(mean > 1e-3 && mean < 1e3, "{mean}");
        let labels = scene.load_labels(view).expect("ids").expect("labels");
        assert!(labels.data.iter().any(|&id| scene.class(id).is_some()));
        assert!(scene.load_mask(view).expect("no mask").is_none());
        println!("{name}: {:?}", scene.warnings);
    }
}

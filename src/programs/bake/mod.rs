//! Lightmaps of any glTF file: what its lamps, its luminous surfaces and an environment send to its
//! surfaces, over all bounces.
//!
//! `scene` reads the file, `layout` gives every surface its place, `lightmap` samples, `seams`
//! joins what the layout cut, `output` writes the file again with its lightmap, `godot` for that engine.

mod document;
mod godot;
mod layout;
mod lightmap;
mod looks;
mod options;
mod output;
mod record;
mod scene;
mod seams;
mod sky;
#[cfg(test)]
mod tests;

pub use layout::Layout;
pub use options::{BakeOptions, GodotVersion};
pub use record::{BAKE, BakeRecord};

use crate::core::formats::{
    AsideFolder, GltfFile, MOST_DATA, atomic_write, glb_of, read_input, read_panorama,
    remove_if_there, write_rgb_float,
};
use crate::core::geometry::Mesh;
use crate::core::progress::Progress;
use crate::core::trace::{CutOut, EmbreeTracer, Tracer};
use crate::error::{Error, Result};
use crate::render::{LightmapTexels, PathTracer, PathTracerOptions, buried, inside};
use looks::Looks;
use output::Lit;
use scene::BakeScene;
use seams::Seams;
use sky::Sky;
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

/// Names of the maps: irradiance, and with directions its mean and slopes.
const MAPS: [&str; 5] = [
    "lightmap.exr",
    "lightmap_mean.exr",
    "lightmap_slope_x.exr",
    "lightmap_slope_y.exr",
    "lightmap_slope_z.exr",
];
/// Name of the scene with its lightmap.
const SCENE: &str = "scene.glb";

/// What is to be baked.
pub struct BakeJob<'a> {
    /// A `.glb` or `.gltf` file.
    pub scene: &'a Path,
    /// How.
    pub options: &'a BakeOptions,
    /// Key of all random numbers.
    pub seed: u64,
}

/// Bakes the light of a file; writes the lightmap, the scene with it and `bake.json` into a folder.
/// Returns what the latter holds and the names of the files.
///
/// # Errors
/// Options out of range; a file that cannot be used or in which nothing shines; writing fails.
pub fn bake_file(
    job: &BakeJob<'_>,
    out: &Path,
    progress: &Progress,
) -> Result<(BakeRecord, Vec<&'static str>)> {
    let clock = std::time::Instant::now();
    job.options.validate()?;
    let bytes = read_input(job.scene, MOST_DATA)?;
    let file = GltfFile::open(&bytes, job.scene)?;
    let mut notes = BTreeSet::new();
    let lit = light(job, &file, &mut notes, progress)?;
    let document = output::lit_document(&file, job.scene, &lit)?;
    let aside = AsideFolder::new(out)?;
    let mut files = vec![SCENE];
    for (name, map) in MAPS.iter().zip(&lit.baked.maps) {
        write_rgb_float(aside.path().join(name), map)?;
        files.push(name);
    }
    let glb = glb_of(&document.root, &document.bytes)?;
    atomic_write(aside.path().join(SCENE), &glb)?;
    match job.options.godot {
        Some(version) => {
            let map = &lit.baked.maps[0];
            godot::write_godot(aside.path(), version, &document, map, &mut notes)?;
        }
        None if out.join(godot::FOLDER).is_dir() => {
            notes.insert(format!(
                "the folder {} is of an earlier bake; give --godot to renew it",
                godot::FOLDER
            ));
        }
        None => {}
    }
    let record = BakeRecord {
        unbake: env!("CARGO_PKG_VERSION").into(),
        scene: job.scene.display().to_string(),
        options: job.options.clone(),
        seed: job.seed,
        triangles: lit.scene.mesh.triangles.len(),
        lights: lit.scene.lights.len(),
        layout: lit.layout,
        samples: lit.baked.samples,
        seconds: clock.elapsed().as_secs_f64(),
        error: lit.baked.error,
        error_of_halves: lit.baked.error_of_halves,
        mean_irradiance: lit.baked.mean.to_array(),
        step_at_seams: lit.seams[1],
        step_at_seams_before: lit.seams[0],
        picture: document.shown,
        notes: notes.into_iter().collect(),
    };
    record.write(aside.path())?;
    files.push(BAKE);
    publish(&aside, out, &files, job.options)?;
    if job.options.godot.is_some() {
        files.push(godot::FOLDER);
    }
    Ok((record, files))
}

/// Puts a bake's files into place, and takes away the maps that an earlier one left and this one has
/// not.
fn publish(
    aside: &AsideFolder,
    out: &Path,
    files: &[&'static str],
    options: &BakeOptions,
) -> Result<()> {
    let mut names: Vec<PathBuf> = files.iter().map(PathBuf::from).collect();
    if options.godot.is_some() {
        let folder = out.join(godot::FOLDER);
        std::fs::create_dir_all(&folder).map_err(|e| Error::io(&folder, e))?;
        names.extend(godot::FILES.map(|name| Path::new(godot::FOLDER).join(name)));
    }
    aside.publish(out, &names)?;
    let mut stale = MAPS.iter().filter(|name| !files.contains(name));
    stale.try_for_each(|name| remove_if_there(&out.join(name)))
}

/// Reads, lays out and lights a file's scene.
fn light(
    job: &BakeJob<'_>,
    file: &GltfFile<'_>,
    notes: &mut BTreeSet<String>,
    progress: &Progress,
) -> Result<Lit> {
    let options = job.options;
    let mut scene = progress.stage("reading the scene", 1, |_| {
        BakeScene::read(file, job.scene, notes)
    })?;
    let sky = read_sky(options)?;
    scene.lights.extend(sky.suns.iter().cloned());
    if !shines(&scene, &sky) {
        return Err(Error::input(
            job.scene,
            "nothing shines: no emissive material, no light (KHR_lights_punctual); export the lamps with the scene, or give --environment FILE",
        ));
    }
    let layout = progress.stage("laying out", 1, |_| layout::lay_out(&mut scene, options))?;
    let largest = options.size.is_none() && layout.size == options::MOST_SIDE as usize;
    if largest && layout.texels_per_metre < 0.9 * options.texels_per_metre {
        notes.insert(format!(
            "{:.1} texels per metre instead of {}: more would exceed {} texels a side; divide the scene, or give --size",
            layout.texels_per_metre, options.texels_per_metre, options::MOST_SIDE
        ));
    }
    let embree = EmbreeTracer::new(&scene.mesh)?;
    let cut_out = CutOut::new(&embree, &scene.looks);
    let tracer: &dyn Tracer = match scene.looks.has_holes() {
        true => &cut_out,
        false => &embree,
    };
    let settings = PathTracerOptions {
        seed: job.seed,
        ..PathTracerOptions::default()
    };
    let renderer = PathTracer::new(&scene.mesh, tracer, &scene.looks, &sky, settings)
        .with_points(scene.lights.clone());
    let open = scene.looks.without_panes();
    let seen = CutOut::new(&embree, &open);
    let texels = visible_texels(&scene.mesh, &layout, &scene.looks, &seen);
    if texels.open().is_empty() {
        return Err(Error::input(
            job.scene,
            "no texel of the lightmap sees anything: the surface is too small for it or faces inwards everywhere; raise --texels-per-metre or --size, or turn the faces",
        ));
    }
    let mut baked = lightmap::bake(&texels, &renderer, options, progress);
    if !(baked.error.is_finite()
        && baked
            .maps
            .iter()
            .flat_map(|m| &m.data)
            .all(|e| e.is_finite()))
    {
        return Err(Error::input(
            job.scene,
            "its light is beyond what 32-bit numbers hold; lower the lamps' intensity, the emissive strength or --environment-scale",
        ));
    }
    let seams = progress.stage("joining seams", 1, |_| {
        let seams = Seams::new(&scene.mesh, layout.size);
        let before = seams.step(&baked.maps[0]);
        baked.maps.iter_mut().for_each(|map| seams.close(map));
        for value in &mut baked.maps[0].data {
            *value = value.max(glam::Vec3::ZERO);
        }
        [before, seams.step(&baked.maps[0])]
    });
    Ok(Lit {
        scene,
        layout,
        baked,
        seams,
    })
}

/// Which triangles lie on another one with the same corners: faces stored once per side, whose
/// backs nobody sees.
fn backed(mesh: &Mesh) -> Vec<bool> {
    let keys: Vec<[[u32; 3]; 3]> = (0..mesh.triangles.len())
        .map(|t| mesh.corner_key(t))
        .collect();
    let mut count: BTreeMap<[[u32; 3]; 3], u32> = BTreeMap::new();
    for key in &keys {
        *count.entry(*key).or_default() += 1;
    }
    keys.iter().map(|key| count[key] > 1).collect()
}

fn read_sky(options: &BakeOptions) -> Result<Sky> {
    let Some(path) = &options.environment else {
        return Ok(Sky::black());
    };
    let panorama = read_panorama(path)?;
    let turn = options.environment_turn.to_radians();
    Ok(Sky::new(panorama, options.environment_scale, turn))
}

fn shines(scene: &BakeScene, sky: &Sky) -> bool {
    use crate::render::Environment;
    let light = scene.lights.iter().any(|l| l.intensity != glam::Vec3::ZERO);
    light || scene.looks.shines() || !sky.is_black()
}

/// The texels of the map that can be seen; those inside of bodies or under things take the light
/// beside them, for they would darken the borders of what is seen.
fn visible_texels<'m>(
    mesh: &'m Mesh,
    layout: &Layout,
    looks: &Looks,
    tracer: &dyn Tracer,
) -> LightmapTexels<'m> {
    let texels = LightmapTexels::new(mesh, layout.size);
    let texel = 1.0 / layout.texels_per_metre.max(f32::MIN_POSITIVE);
    let under = buried(texels.points(), texel, tracer);
    let backed = backed(mesh);
    let one_sided = |t: usize| looks.is_one_sided(t) && !backed[t];
    let within = inside(texels.points(), 1e-2 * texel, mesh, tracer, &one_sided);
    let hidden: Vec<bool> = under.iter().zip(&within).map(|(a, b)| *a || *b).collect();
    texels.without(&hidden)
}

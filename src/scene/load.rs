//! Loading a scene folder: every problem of every file is collected before anything is refused.

use super::input_error::{as_input, limited};
use super::mesh_classes::{Named, mesh_classes};
use super::mesh_prep::prepare_mesh;
use super::transforms::{Frame, Model, Transforms, parse_usable, y_up_from_z_up};
use super::{
    Class, LdrImages, LoadOptions, MeshClasses, Mirror, Scene, Split, View, decoding, rooms,
    unnamed_class,
};
use crate::core::formats::{self, ImageAccount, ImageInfo};
use crate::core::geometry::Camera;
use crate::core::parallel::prelude::*;
use crate::core::switch::Switch;
use crate::{Error, Result};
use glam::{DMat3, DVec3};
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

/// Height of a mesh above which its unit is doubted, metres. Derived: a room of 2.5 m is 98 high in inches
/// and 250 in centimetres; few halls are higher than this.
const HIGHEST: f32 = 60.0;

/// Where a scene is described, and what its relative paths are relative to.
struct SceneFile {
    file: PathBuf,
    folder: PathBuf,
}

impl SceneFile {
    /// Of a scene's folder, or of its file.
    fn at(path: &Path) -> Self {
        let file = if path.is_dir() {
            path.join("transforms.json")
        } else {
            path.to_path_buf()
        };
        let folder = file
            .parent()
            .filter(|p| !p.as_os_str().is_empty())
            .unwrap_or(Path::new("."))
            .to_path_buf();
        Self { file, folder }
    }
}

/// The views that can be used; what is wrong with the others joins `issues`.
fn usable<E: IntoIterator<Item = Error>>(
    checked: Vec<std::result::Result<View, E>>,
    issues: &mut Vec<Error>,
) -> Vec<View> {
    let mut views = Vec::new();
    for result in checked {
        match result {
            Ok(v) => views.push(v),
            Err(e) => issues.extend(e),
        }
    }
    views
}

impl Scene {
    /// Loads and validates the scene in a folder (or described by a JSON file given directly).
    ///
    /// Pixels are not decoded, only the image headers are read; class ids are gathered from the
    /// label images if the file declares none. All problems are reported at once as
    /// [`Error::Inputs`].
    ///
    /// # Errors
    /// Everything that is wrong with the scene at once, each with its file and place.
    pub fn load(path: impl AsRef<Path>, options: &LoadOptions) -> Result<Self> {
        let SceneFile { file, folder } = SceneFile::at(path.as_ref());
        let (transforms, mut issues) =
            read_transforms(&file).map_err(|e| limited(e, options.max_issues))?;
        // what is missing may be there under a misspelt name: said first
        let refusal = |mut issues: Vec<Error>| {
            let misspelt = transforms.misspelt.iter();
            issues.splice(0..0, misspelt.map(|k| Error::input(&file, k.clone())));
            limited(issues, options.max_issues)
        };
        let mut warnings = transforms.warnings.clone();
        let splits = splits(&transforms, &file, &mut issues, &mut warnings);
        check_stems(&transforms.frames, &file, &mut issues);
        let mesh_path = resolved(&folder, &transforms.mesh_path);
        if transforms.mesh_path.is_empty() {
            return Err(refusal(issues));
        }
        let mut names = Vec::new();
        let mesh = formats::read_mesh(&mesh_path).and_then(|mut raw| {
            names = std::mem::take(&mut raw.names);
            let z_up = mesh_is_z_up(&transforms, &raw, &mut warnings);
            prepare_mesh(raw, &mesh_path, z_up, options)
        });
        let origin = mesh.as_ref().map_or(DVec3::ZERO, |m| m.origin);
        let checked: Vec<_> = transforms
            .frames
            .par_iter()
            .zip(&splits)
            .filter_map(|(f, s)| s.map(|s| view(f, s, &folder, origin, options)))
            .collect();
        let mut views = usable(checked, &mut issues);
        warnings.extend(level_white(&mut views));
        warnings.extend(level_exposure(&mut views, &transforms.frames));
        warnings.extend(completed_note(&transforms.frames, &views));
        let classes_declared = transforms.classes.is_some();
        let unlabelled = views.iter().all(|v| v.label_path.is_none());
        let named = mesh.as_ref().ok().filter(|_| unlabelled);
        let named = named.map(|mesh| Named::prepared(mesh, &names));
        let declared = transforms.classes;
        let classes = SceneClasses::of(named, declared, options.mesh_classes)
            .unwrap_or_else(|| SceneClasses::derived(&views, options, &mut issues));
        let rooms = transforms.rooms_path.as_ref().and_then(|p| {
            rooms::read_rooms(&resolved(&folder, p), origin)
                .map_err(|e| issues.push(e))
                .ok()
        });
        let mesh = match mesh {
            Ok(m) => m,
            Err(e) => {
                issues.insert(0, e);
                return Err(refusal(issues));
            }
        };
        if !issues.is_empty() {
            return Err(refusal(issues));
        }
        let scene = Self {
            origin,
            mesh: mesh.mesh,
            classes: classes.list,
            views,
            rooms,
            classes_declared,
            mesh_classes: classes.of_mesh,
            mesh_stats: mesh.stats,
            z_up: transforms.z_up,
            mirror: Mirror::None,
            warnings,
            camera_masks: Vec::new(),
            options: options.clone(),
            files: {
                let rooms = transforms.rooms_path.iter().map(|p| resolved(&folder, p));
                let grids = rooms.flat_map(|p| [rooms::description(&p), p]);
                [file, mesh_path.clone()].into_iter().chain(grids).collect()
            },
            folder,
        };
        Ok(scene.with_ldr_note().with_mesh_warnings(&mesh_path))
    }

    /// Says what display-referred photographs are taken for.
    fn with_ldr_note(mut self) -> Self {
        let referred = |v: &&View| v.account.is_display_referred();
        let names: Vec<&str> = (self.views.iter().filter(referred))
            .map(|v| v.stem.as_str())
            .collect();
        if let Some(first) = names.first() {
            self.warnings.push(format!(
                "{} of {} photographs are display-referred (PNG or JPEG; first: {first}): taken as sRGB unless they or color_space say otherwise, their brightest values as lower bounds of the light",
                names.len(),
                self.views.len()
            ));
        }
        self
    }

    /// Adds what a user should know about geometry and cameras although the scene is usable.
    pub(super) fn with_mesh_warnings(mut self, mesh_path: &Path) -> Self {
        let s = &self.mesh_stats;
        let name = mesh_path.display();
        let mut notes = Vec::new();
        notes.extend(self.mesh_classes.as_ref().map(|m| {
            format!(
                "{name}: no label images, so its {}; --mesh-classes off leaves them out",
                m.account(&self.classes)
            )
        }));
        if s.degenerate > 0 {
            notes.push(format!(
                "{name}: {} of {} triangles have no area and are left out",
                s.degenerate, s.file_triangles
            ));
        }
        if s.coincident > 0 {
            notes.push(format!(
                "{name}: {} of {} triangles lie on others with the same corners (faces stored once per side) and are merged with them",
                s.coincident, s.file_triangles
            ));
        }
        if s.normals_computed > 0 {
            notes.push(format!(
                "{name}: normals of {} vertices were missing and are computed from the faces",
                s.normals_computed
            ));
        }
        if let Some(u) = &s.unwrapped {
            let why = match s.overlap_dropped {
                share if share > 0.0 => format!(
                    "{:.0} % of the atlas is claimed by several triangles (one atlas per material?), so it is not used",
                    100.0 * share
                ),
                _ if s.parts_without_uvs > 0 => format!(
                    "parts without texture coordinates: {} (first: {}), so those of the others are no atlas of the whole",
                    s.parts_without_uvs,
                    s.first_without_uvs.as_deref().unwrap_or_default()
                ),
                _ if self.options.unwrap => "a new atlas is asked for".into(),
                _ => "no atlas given".into(),
            };
            notes.push(format!(
                "{name}: {why}; unwrapped into {} charts, {:.0} % filled",
                u.charts,
                100.0 * u.fill
            ));
        }
        if s.without_texels > 0 {
            notes.push(format!(
                "{name}: {} triangles have no area in the atlas and get no texels",
                s.without_texels
            ));
        }
        if s.overlapping_texels > 0 {
            notes.push(format!(
                "{name}: {} of {} texels (at 2048²) are claimed by several triangles, whose materials get mixed; pass --unwrap for a new atlas",
                s.overlapping_texels, s.covered_texels
            ));
        }
        let (lo, hi) = self.mesh.bounds();
        notes.extend(unit_note(&name, hi.y - lo.y));
        let outside: Vec<&str> = self
            .views
            .iter()
            .filter(|v| v.camera.position.cmplt(lo).any() || v.camera.position.cmpgt(hi).any())
            .map(|v| v.stem.as_str())
            .collect();
        if !outside.is_empty() {
            notes.push(format!(
                "{} of {} cameras lie outside the mesh's bounding box (first: {}); are mesh and poses in the same coordinates and metres? up_axis \"z\" turns both",
                outside.len(),
                self.views.len(),
                outside[0]
            ));
        }
        self.warnings.extend(notes);
        self
    }
}

/// Doubts the unit of a mesh that is higher than halls are, metres.
fn unit_note(name: impl std::fmt::Display, height: f32) -> Option<String> {
    (height > HIGHEST).then(|| {
        format!(
            "{name} is {height:.0} m high: one unit is one metre. If it is in centimetres, inches or millimetres, write mesh and poses in metres \
             (`unbake prepare nerfstudio SCENE -o NEW --scale METRES_PER_UNIT` does)"
        )
    })
}

/// A path of the file, relative to the scene's folder. Windows writes `\` between folders: read as
/// `/` where no file of that very name exists.
fn resolved(folder: &Path, named: &str) -> PathBuf {
    let path = folder.join(named);
    let forward = folder.join(named.replace('\\', "/"));
    match named.contains('\\') && !path.exists() && forward.exists() {
        true => forward,
        false => path,
    }
}

/// Whether the mesh has to be turned from z up to y up.
///
/// `mesh_up_axis` decides, else `up_axis`. glTF is y up by its standard, but not every exporter
/// keeps to it: in a z-up scene it is turned unless more cameras stand inside its bounding box as
/// it is.
fn mesh_is_z_up(t: &Transforms, raw: &formats::RawMesh, warnings: &mut Vec<String>) -> bool {
    if let Some(z_up) = t.mesh_z_up {
        return z_up;
    }
    let extension = Path::new(&t.mesh_path).extension().unwrap_or_default();
    let gltf = ["glb", "gltf"]
        .iter()
        .any(|e| extension.eq_ignore_ascii_case(e));
    if !(t.z_up && gltf) {
        return t.z_up;
    }
    let inside = |turn: DMat3| -> usize {
        let corners = raw
            .positions
            .iter()
            .filter(|p| p.is_finite())
            .map(|p| turn * *p);
        let start = (DVec3::INFINITY, DVec3::NEG_INFINITY);
        let (lo, hi) = corners.fold(start, |(lo, hi), p| (lo.min(p), hi.max(p)));
        let contains = |f: &&Frame| f.position.cmpge(lo).all() && f.position.cmple(hi).all();
        t.frames.iter().filter(contains).count()
    };
    let (as_it_is, turned) = (inside(DMat3::IDENTITY), inside(y_up_from_z_up()));
    if as_it_is > turned {
        warnings.push(format!(
            "{}: glTF is y up by its standard, so up_axis \"z\" turns the poses only ({as_it_is} of {} cameras stand inside it as it is, {turned} if it were turned); mesh_up_axis \"z\" turns it too",
            t.mesh_path,
            t.frames.len()
        ));
    }
    as_it_is <= turned
}

/// The usable part of the file with the problems of the rest; `Err` if nothing of it can be used.
fn read_transforms(file: &Path) -> std::result::Result<(Transforms, Vec<Error>), Vec<Error>> {
    let bytes = formats::read_input(file, formats::MOST_TEXT).map_err(|e| {
        vec![e.advise("give a scene folder that holds transforms.json, or such a file")]
    })?;
    let text = std::str::from_utf8(formats::without_mark(&bytes)).map_err(|e| {
        vec![Error::input(
            file,
            format!(
                "byte {} is not UTF-8; save the file as UTF-8 JSON",
                e.valid_up_to()
            ),
        )]
    })?;
    let named = |issues: Vec<String>| issues.into_iter().map(|m| Error::input(file, m)).collect();
    parse_usable(text)
        .map(|(t, issues)| (t, named(issues)))
        .map_err(named)
}

/// The split of every frame; `None` for frames neither list names.
fn splits(
    t: &Transforms,
    file: &Path,
    issues: &mut Vec<Error>,
    warnings: &mut Vec<String>,
) -> Vec<Option<Split>> {
    let mut fail = |m: String| issues.push(Error::input(file, m));
    let plain = |s: &str| s.strip_prefix("./").unwrap_or(s).to_owned();
    let known: BTreeSet<String> = t.names.iter().map(|n| plain(n)).collect();
    let mut listed = |list: &Option<Vec<String>>, key: &str| -> Option<BTreeSet<String>> {
        let names: BTreeSet<String> = list.as_ref()?.iter().map(|s| plain(s)).collect();
        for missing in names.difference(&known) {
            fail(format!(
                "{key}: \"{missing}\" is no frame's file_path; write the names exactly as in frames"
            ));
        }
        Some(names)
    };
    let (train, test) = (
        listed(&t.train, "train_filenames"),
        listed(&t.test, "test_filenames"),
    );
    match (&train, &test) {
        (Some(names), _) if names.is_empty() => fail("train_filenames: empty; name at least one training image".into()),
        (None, Some(_)) => {
            fail("test_filenames without train_filenames: no image to reconstruct from; add train_filenames".into())
        }
        (Some(a), Some(b)) => {
            for both in a.intersection(b) {
                fail(format!("\"{both}\" is in train_filenames and test_filenames; leave it in one of them"));
            }
        }
        _ => {}
    }
    let split: Vec<Option<Split>> = t
        .frames
        .iter()
        .map(|f| {
            let name = plain(&f.file_path);
            match (&train, &test) {
                (None, _) => Some(Split::Train),
                (Some(a), _) if a.contains(&name) => Some(Split::Train),
                (_, Some(b)) if b.contains(&name) => Some(Split::Test),
                _ => None,
            }
        })
        .collect();
    let unused = split.iter().filter(|s| s.is_none()).count();
    if unused > 0 {
        warnings.push(format!(
            "{unused} frames are in neither train_filenames nor test_filenames and are not used"
        ));
    }
    split
}

/// File stems name everything written for a view, so each may occur once.
fn check_stems(frames: &[Frame], file: &Path, issues: &mut Vec<Error>) {
    let mut seen: BTreeMap<String, &Frame> = BTreeMap::new();
    for f in frames {
        let Some(stem) = stem(&f.file_path) else {
            issues.push(Error::input(
                file,
                format!(
                    "frames[{}].file_path: \"{}\" names no file",
                    f.index, f.file_path
                ),
            ));
            continue;
        };
        if let Some(first) = seen.insert(stem.clone(), f) {
            issues.push(Error::input(
                file,
                format!(
                    "frames[{}] ({}) and frames[{}] ({}) share the file stem \"{stem}\", which names their outputs; rename one",
                    first.index, first.file_path, f.index, f.file_path
                ),
            ));
        }
    }
}

fn stem(path: &str) -> Option<String> {
    Some(Path::new(path).file_stem()?.to_str()?.to_owned())
}

/// Checks a frame's files by their headers.
fn view(
    f: &Frame,
    split: Split,
    folder: &Path,
    origin: DVec3,
    options: &LoadOptions,
) -> std::result::Result<View, Vec<Error>> {
    let image_path = photograph_path(folder, &f.file_path);
    let mut issues = Vec::new();
    let info = match formats::image_account(&image_path, f.colour_space) {
        Ok(i) => Some(i),
        Err(e) => {
            issues.push(as_input(e, &image_path, &format!("frames[{}]", f.index)));
            None
        }
    };
    let referred = info.as_ref().is_some_and(|i| i.is_display_referred());
    if referred && options.ldr == LdrImages::Off {
        issues.push(Error::input(
            &image_path,
            "display-referred image: its values are not proportional to light. Give EXR or Radiance HDR, or leave out --ldr off to take it as sRGB",
        ));
    }
    if let Some(i) = &info {
        if let Some([w, h]) = f.size.filter(|s| *s != [i.width, i.height]) {
            issues.push(Error::input(
                &image_path,
                format!(
                    "the image is {}x{}, transforms.json says {w}x{h} for frames[{}]; {}",
                    i.width,
                    i.height,
                    f.index,
                    match i.orientation > 4 && [h, w] == [i.width, i.height] {
                        true => "viewers turn it by its EXIF orientation, unbake does not: give w, h, lens and pose of the stored rows, or turn the pixels and remove the tag (`exiftran -ai`, `magick mogrify -auto-orient`)",
                        false => "correct w and h or the image",
                    }
                ),
            ));
        } else if f.model == Model::Equirectangular && i.width != 2 * i.height {
            issues.push(Error::input(
                &image_path,
                format!(
                    "{}x{} is no full panorama; EQUIRECTANGULAR needs a width of twice the height",
                    i.width, i.height
                ),
            ));
        }
    }
    let side_file =
        |path: &Option<String>, what: &str, issues: &mut Vec<Error>| -> Option<PathBuf> {
            let path = resolved(folder, path.as_ref()?);
            match (formats::image_info(&path), &info) {
                (Err(e), _) => issues.push(as_input(e, &path, &format!("frames[{}]", f.index))),
                (Ok(side), Some(image)) => {
                    let wrong = unfit(&side, image, what);
                    issues.extend(wrong.map(|m| Error::input(&path, m)));
                }
                _ => {}
            }
            Some(path)
        };
    let label_path = side_file(&f.label_path, "label", &mut issues);
    let mask_path = side_file(&f.mask_path, "mask", &mut issues);
    let (Some(info), Some(stem), true) = (info, stem(&f.file_path), issues.is_empty()) else {
        return Err(issues);
    };
    let camera = camera(f, &info, origin);
    Ok(View {
        colour_space: f.colour_space,
        account: info,
        stem,
        camera,
        image_path,
        label_path,
        mask_path,
        exposure_ev: f.exposure_ev.unwrap_or(0.0),
        split,
    })
}

fn camera(f: &Frame, info: &ImageAccount, origin: DVec3) -> Camera {
    Camera {
        projection: f.model.projection(info.width, info.height),
        width: info.width,
        height: info.height,
        world_from_camera: f.rotation.as_mat3(),
        position: (f.position - origin).as_vec3(),
    }
}

/// Brings views to one scale whose files state different luminances of white (`whiteLuminance`);
/// what a user should know of it.
fn level_white(views: &mut [View]) -> Vec<String> {
    let stated: Vec<f64> = views
        .iter()
        .filter_map(|v| v.account.white_luminance)
        .collect();
    let Some(first) = stated.first().copied() else {
        return Vec::new();
    };
    if stated.iter().all(|w| (w / first - 1.0).abs() < 1e-3) {
        return Vec::new();
    }
    if stated.len() < views.len() {
        return vec![format!(
            "{} of {} images state whiteLuminance, with different values, the others do not: it is ignored; set exposure_ev where exposures differ",
            stated.len(),
            views.len()
        )];
    }
    for v in views.iter_mut() {
        let own = v.account.white_luminance.unwrap_or(first);
        v.exposure_ev += (own / first).log2() as f32;
    }
    vec![
        "the images state different whiteLuminance: all are brought to the scale of the first"
            .into(),
    ]
}

/// Exposures that differ by less are left to `solve`, which finds them. Derived: the smallest step
/// of cameras is a third of a stop, 26 %.
const SAME_EXPOSURE: f64 = 0.1;

/// Brings photographs to one scale whose EXIF data state different exposures, where the scene says
/// nothing of them; what a user should know of it.
fn level_exposure(views: &mut [View], frames: &[Frame]) -> Option<String> {
    if frames.iter().any(|f| f.exposure_ev.is_some()) {
        return None;
    }
    let stated: Vec<f64> = views
        .iter()
        .filter_map(|v| v.account.exif_exposure)
        .collect();
    let first = *stated.first()?;
    let least = stated.iter().copied().fold(first, f64::min);
    let most = stated.iter().copied().fold(first, f64::max);
    if most / least <= 1.0 + SAME_EXPOSURE {
        return None;
    }
    let stops = (most / least).log2();
    if stated.len() < views.len() {
        return Some(format!(
            "the EXIF data of {} of {} photographs state exposures that differ by up to {stops:.1} stops, the others none: they are not used; set exposure_ev where exposures differ",
            stated.len(),
            views.len()
        ));
    }
    for v in views.iter_mut() {
        let own = v.account.exif_exposure.unwrap_or(first);
        v.exposure_ev += (first / own).log2() as f32;
    }
    Some(format!(
        "the EXIF data of the photographs state exposures (time · ISO / aperture²) that differ by up to {stops:.1} stops, and no frame has exposure_ev: all are brought to the scale of the first; exposure_ev of the frames overrides it (0 where they were levelled already)"
    ))
}

/// Says which photographs were found by a `file_path` without its ending.
fn completed_note(frames: &[Frame], views: &[View]) -> Option<String> {
    let bare: BTreeSet<String> = frames
        .iter()
        .filter(|f| Path::new(&f.file_path).extension().is_none())
        .filter_map(|f| stem(&f.file_path))
        .collect();
    let found: Vec<&View> = views
        .iter()
        .filter(|v| v.image_path.extension().is_some() && bare.contains(&v.stem))
        .collect();
    let first = found.first()?;
    Some(format!(
        "file_path of {} frames has no ending: the only photograph of that name is taken (first: {})",
        found.len(),
        first.image_path.display()
    ))
}

/// The photograph that a `file_path` names. NeRF's synthetic scenes and instant-ngp leave the ending
/// out: then it is the only image of that name.
fn photograph_path(folder: &Path, named: &str) -> PathBuf {
    const ENDINGS: [&str; 5] = ["exr", "hdr", "png", "jpg", "jpeg"];
    let path = resolved(folder, named);
    if path.extension().is_some() || path.exists() {
        return path;
    }
    let small = ENDINGS.iter().map(|e| (*e).to_owned());
    let large = ENDINGS.iter().map(|e| e.to_uppercase());
    let mut found = small
        .chain(large)
        .map(|e| path.with_extension(e))
        .filter(|p| p.is_file());
    match (found.next(), found.next()) {
        (Some(only), None) => only,
        _ => path,
    }
}

/// By how many times a label or mask image may be finer than its photograph, in columns; smaller
/// ones than [`HARMLESS`] pixels always may. Derived: texels are no finer than pixels of
/// photographs, and a few kilobytes of PNG can state hundreds of megabytes.
const FINER: usize = 8;
const HARMLESS: usize = 1 << 24;

/// Why a label or mask image cannot belong to its photograph, if so.
fn unfit(side: &ImageInfo, image: &ImageAccount, what: &str) -> Option<String> {
    let sizes = format!(
        "the {what} image is {}x{}, its photograph {}x{}",
        side.width, side.height, image.width, image.height
    );
    if !same_aspect(side, image) {
        return Some(format!(
            "{sizes}; any resolution will do, but the aspect must be the same"
        ));
    }
    let oversized = side.width * side.height > HARMLESS && side.width > FINER * image.width;
    oversized.then(|| {
        format!("{sizes}; expected at most {FINER} times as many columns: save it smaller")
    })
}

/// Whether two sizes show the same aspect to within one pixel of the smaller.
fn same_aspect(a: &ImageInfo, b: &ImageAccount) -> bool {
    let (aw, ah, bw, bh) = (
        a.width as f64,
        a.height as f64,
        b.width as f64,
        b.height as f64,
    );
    let expected = aw * bh / bw;
    (expected - ah).abs() <= 0.5 + 1e-9 || (ah * bw / bh - aw).abs() <= 0.5 + 1e-9
}

/// A scene's classes.
struct SceneClasses {
    list: Vec<Class>,
    /// Those that the mesh has by itself.
    of_mesh: Option<MeshClasses>,
}

impl SceneClasses {
    /// Those that the mesh names, if it may be asked, with those that are declared; `None` where
    /// there are neither.
    fn of(named: Option<Named<'_>>, declared: Option<Vec<Class>>, switch: Switch) -> Option<Self> {
        let by_name = named.and_then(|n| mesh_classes(&n, declared.as_deref(), switch));
        match by_name {
            Some(found) => Some(Self {
                list: found.classes,
                of_mesh: Some(found.mesh),
            }),
            None => declared.map(|list| Self {
                list,
                of_mesh: None,
            }),
        }
    }

    /// Those of a scene that declares none: every id in the label images.
    fn derived(views: &[View], options: &LoadOptions, issues: &mut Vec<Error>) -> Self {
        Self {
            list: derived_classes(views, options, issues),
            of_mesh: None,
        }
    }
}

/// Every id in the label images, as classes.
fn derived_classes(views: &[View], options: &LoadOptions, issues: &mut Vec<Error>) -> Vec<Class> {
    let labelled = views.iter().filter_map(|v| v.label_path.as_ref());
    let labelled: Vec<&PathBuf> = labelled.collect();
    let ids_in = |path: &&PathBuf| -> Result<BTreeSet<u16>> {
        let labels = formats::read_labels(path).map_err(|e| as_input(e, path, "label_path"))?;
        Ok(labels.data.into_iter().collect())
    };
    let mut ids = BTreeSet::new();
    for f in decoding(views, options).map(&labelled, ids_in) {
        match f {
            Ok(f) => ids.extend(f),
            Err(e) => issues.push(e),
        }
    }
    ids.into_iter()
        .filter(|&id| id > 0)
        .map(|id| Class {
            id,
            name: unnamed_class(id),
            is_light: false,
        })
        .collect()
}

//! `camera_mask_*.png` of an output folder: 0 where a photograph shows what its camera carries
//! along, 255 where it shows the scene, as `mask_path` of a scene.

use crate::core::formats::{AsideFolder, read_labels, write_png8};
use crate::core::image::CameraMask;
use crate::error::{Error, Result};
use std::path::Path;

/// Every mask file begins with this.
const PREFIX: &str = "camera_mask_";
/// File names by kind of image.
const KINDS: [(&str, bool); 2] = [("panorama", true), ("pinhole", false)];

fn file_name(mask: &CameraMask) -> String {
    let kind = KINDS[usize::from(!mask.panorama)].0;
    let (w, h) = (mask.visible.width, mask.visible.height);
    format!("{PREFIX}{kind}_{w}x{h}.png")
}

/// Whether a name is that of a mask, and of which kind.
fn kind_of(name: &str) -> Option<bool> {
    let rest = name.strip_prefix(PREFIX)?.strip_suffix(".png")?;
    KINDS.iter().find(|k| rest.starts_with(k.0)).map(|k| k.1)
}

/// The names of a folder's masks, in order.
fn names(folder: &Path) -> Result<Vec<String>> {
    let mut names = Vec::new();
    for entry in std::fs::read_dir(folder).map_err(|e| Error::io(folder, e))? {
        let name = entry.map_err(|e| Error::io(folder, e))?.file_name();
        names.extend(
            name.to_str()
                .filter(|n| kind_of(n).is_some())
                .map(String::from),
        );
    }
    names.sort();
    Ok(names)
}

pub(super) fn write_camera_masks(folder: &Path, masks: &[CameraMask]) -> Result<()> {
    for mask in masks {
        let grey = mask.visible.map(|v| if *v { 255 } else { 0 });
        write_png8(folder.join(file_name(mask)), &grey)?;
    }
    Ok(())
}

/// Puts the new masks in the place of those an earlier solution left.
pub(super) fn replace_camera_masks(aside: &AsideFolder, folder: &Path) -> Result<()> {
    let new = names(aside.path())?;
    for old in names(folder)?.iter().filter(|n| !new.contains(n)) {
        let path = folder.join(old);
        std::fs::remove_file(&path).map_err(|e| Error::io(&path, e))?;
    }
    aside.publish(folder, &new)
}

/// Reads the masks of an output folder; none where it has none.
///
/// # Errors
/// Files that are no grey PNG.
pub(super) fn read_camera_masks(folder: &Path) -> Result<Vec<CameraMask>> {
    let mask = |name: String| {
        let panorama = kind_of(&name).unwrap_or(true);
        let visible = read_labels(folder.join(name))?.map(|v| *v != 0);
        Ok(CameraMask { panorama, visible })
    };
    names(folder)?.into_iter().map(mask).collect()
}

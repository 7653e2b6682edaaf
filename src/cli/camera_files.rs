//! What a list of cameras names: its files must not be overwritten.

use std::path::{Path, PathBuf};

/// Files that a list of cameras or a scene's `transforms.json` names, and the list itself; nothing where it cannot be read, which
/// is somebody else's error.
#[must_use]
pub fn files_of_cameras(list: &Path) -> Vec<PathBuf> {
    let text = crate::core::formats::read_input_text(list).unwrap_or_default();
    let json: serde_json::Value = serde_json::from_str(&text).unwrap_or_default();
    let folder = list.parent().unwrap_or(Path::new("."));
    let frames = json.get("frames").and_then(|f| f.as_array());
    let named = frames.into_iter().flatten().flat_map(|f| {
        let keys = ["file_path", "label_path", "mask_path"];
        keys.map(|k| f.get(k).and_then(|v| v.as_str()))
    });
    let whole = ["mesh_path", "rooms_path"].map(|k| json.get(k).and_then(|v| v.as_str()));
    let all = named.chain(whole).flatten();
    let mut files: Vec<PathBuf> = all.map(|n| folder.join(n)).collect();
    files.push(list.to_path_buf());
    files
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_list_of_cameras_names_its_files() {
        let dir = tempfile::tempdir().expect("temp");
        let list = dir.path().join("c.json");
        std::fs::write(&list, r#"{"frames":[{"file_path":"images/a.exr"},{}]}"#).expect("file");
        let files = files_of_cameras(&list);
        assert_eq!(files, [dir.path().join("images/a.exr"), list]);
        assert_eq!(files_of_cameras(Path::new("/none")).len(), 1);
    }
}

//! What a batch consists of: a text file with a scene a line, or a folder of scenes. Called by
//! `unbake batch`.
//!
//! A line is a scene folder, relative to the list's own, and flags of `solve` after it; words with
//! spaces stand in quotes, `#` at the beginning of a word starts a comment. The line's place among
//! the scenes is the scene's index, from 0.

use crate::core::formats::read_input_text;
use crate::error::{Error, Result};
use std::collections::HashSet;
use std::path::{Path, PathBuf};

/// Names inside the output folder that are the batch's own.
const RESERVED: [&str; 2] = ["batch.json", "batch.md"];

/// Longest name of a scene's folder. Derived: file systems take 255 bytes, a character is up to 4,
/// and a number follows.
const MOST_CHARACTERS: usize = 60;

/// A scene to solve.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Item {
    /// Name of its folder in the output folder; no two are the same, whatever their case.
    pub name: String,
    /// Scene folder, or its `transforms.json`.
    pub scene: PathBuf,
    /// Flags of `solve` of its own.
    pub flags: Vec<String>,
    /// Line in the list, from 1; 0 in a folder.
    pub line: usize,
}

/// Reads a list, or lists a folder without its hidden sub-folders and without `out`.
///
/// # Errors
/// There is no such file or folder, it is no text, a quote stays open, or it names no scene.
pub fn read_list(list: &Path, out: &Path) -> Result<Vec<Item>> {
    let mut items = match list.is_dir() {
        true => scenes_of_folder(list, out)?,
        false => scenes_of_file(list)?,
    };
    if items.is_empty() {
        let way_out = "names no scene; expected a text file with a scene folder a line, or a folder \
                       whose sub-folders are scenes";
        return Err(Error::input(list, way_out));
    }
    give_names(&mut items);
    Ok(items)
}

fn scenes_of_folder(list: &Path, out: &Path) -> Result<Vec<Item>> {
    if list.join("transforms.json").exists() {
        return Err(Error::input(
            list,
            "is itself a scene; use `unbake solve`, or name the folder that holds the scenes",
        ));
    }
    let cannot = |e| Error::input(list, format!("cannot be listed: {e}"));
    let out = out.canonicalize().ok();
    let mut folders = Vec::new();
    for entry in std::fs::read_dir(list).map_err(cannot)? {
        let path = entry.map_err(cannot)?.path();
        let hidden = path
            .file_name()
            .is_some_and(|n| n.as_encoded_bytes().starts_with(b"."));
        let own = out.is_some() && path.canonicalize().ok() == out;
        if path.is_dir() && !hidden && !own {
            folders.push(path);
        }
    }
    folders.sort();
    Ok(folders.into_iter().map(|f| item(f, vec![], 0)).collect())
}

fn scenes_of_file(list: &Path) -> Result<Vec<Item>> {
    if !list.exists() {
        return Err(Error::input(
            list,
            "no such file or folder; expected a text file with a scene folder a line, or a folder \
             whose sub-folders are scenes",
        ));
    }
    let text = read_input_text(list)?;
    let folder = list.parent().unwrap_or(Path::new("."));
    let mut items = Vec::new();
    for (i, line) in text.lines().enumerate() {
        let bad = |what: &str| Error::input(list, format!("line {}: {what}", i + 1));
        if line.contains('\0') {
            return Err(bad(
                "holds a zero byte; expected text with a scene folder a line",
            ));
        }
        let mut words = words(line).ok_or_else(|| bad("a quote stays open; close it"))?;
        if words.is_empty() {
            continue;
        }
        let path = words.remove(0);
        if path.is_empty() || path.starts_with('-') {
            return Err(bad("begins with no path; expected SCENE [FLAGS OF solve]"));
        }
        items.push(item(folder.join(path), words, i + 1));
    }
    Ok(items)
}

fn item(scene: PathBuf, flags: Vec<String>, line: usize) -> Item {
    Item {
        name: natural_name(&scene),
        scene,
        flags,
        line,
    }
}

/// Words of a line; `None` if a quote stays open.
fn words(line: &str) -> Option<Vec<String>> {
    let mut words = Vec::new();
    let mut word: Option<String> = None;
    let mut quote = None;
    for c in line.chars() {
        match (quote, c) {
            (Some(q), c) if c == q => quote = None,
            (Some(_), c) => word.get_or_insert_default().push(c),
            (None, '"' | '\'') => {
                quote = Some(c);
                word.get_or_insert_default();
            }
            (None, '#') if word.is_none() => break,
            (None, c) if c.is_whitespace() => words.extend(word.take()),
            (None, c) => word.get_or_insert_default().push(c),
        }
    }
    words.extend(word);
    quote.is_none().then_some(words)
}

/// What a scene's folder is called, fit to be a folder's name elsewhere.
fn natural_name(scene: &Path) -> String {
    let file = scene.extension().is_some_and(|e| e == "json") && !scene.is_dir();
    let folder = match file {
        true => scene.parent().unwrap_or(scene),
        false => scene,
    };
    // "." and ".." have a name too
    let really = match folder.file_name() {
        Some(_) => folder.to_path_buf(),
        None => folder.canonicalize().unwrap_or_default(),
    };
    let name = really
        .file_name()
        .map_or("scene".into(), |n| n.to_string_lossy());
    let name: String = name
        .chars()
        .take(MOST_CHARACTERS)
        .map(|c| if c.is_control() { '_' } else { c })
        .collect();
    match name.strip_prefix('.') {
        Some(rest) => format!("_{rest}"),
        None => name,
    }
}

/// Scenes of one name get `name`, `name-2`, `name-3`, …, past names that others have of their own.
fn give_names(items: &mut [Item]) {
    let mut taken: HashSet<String> = RESERVED.map(str::to_owned).into();
    let again: Vec<usize> = (0..items.len())
        .filter(|&i| !taken.insert(items[i].name.to_lowercase()))
        .collect();
    for i in again {
        let numbered = (2..)
            .map(|k| format!("{}-{k}", items[i].name))
            .find(|n| taken.insert(n.to_lowercase()));
        items[i].name = numbered.unwrap_or_default();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn list_of(text: &str) -> Result<Vec<Item>> {
        let dir = tempfile::tempdir().expect("temp");
        let list = dir.path().join("list");
        std::fs::write(&list, text).expect("written");
        read_list(&list, &dir.path().join("out"))
    }

    fn names(items: &[Item]) -> Vec<&str> {
        items.iter().map(|i| i.name.as_str()).collect()
    }

    #[test]
    fn lines_have_paths_flags_quotes_and_comments() {
        let items = list_of(
            "\u{feff}# all\n\n  a/kitchen --quality draft # quick\r\n\"my rooms/hall #1\" --albedo-size '64'\n/x/transforms.json\n",
        )
        .expect("a list");
        assert_eq!(names(&items), ["kitchen", "hall #1", "x"]);
        assert_eq!(items[0].flags, ["--quality", "draft"]);
        assert_eq!(items[1].flags, ["--albedo-size", "64"]);
        assert_eq!((items[0].line, items[1].line), (3, 4));
        assert!(items[0].scene.ends_with("a/kitchen") && items[0].scene.is_absolute());
        assert_eq!(items[2].scene, Path::new("/x/transforms.json"));
    }

    #[test]
    fn no_two_scenes_share_a_folder() {
        let items = list_of("a/k\nb/k\nc/k-2\nd/K\n.hidden\nx/batch.md\na/k\n").expect("a list");
        let names = names(&items);
        let expected = ["k", "k-3", "k-2", "K-4", "_hidden", "batch.md-2", "k-5"];
        assert_eq!(names, expected);
        let different: HashSet<String> = names.iter().map(|n| n.to_lowercase()).collect();
        assert_eq!(different.len(), names.len());
    }

    #[test]
    fn what_is_no_list_is_refused() {
        for (text, said) in [
            ("", "names no scene"),
            ("# nothing\n\n", "names no scene"),
            ("a\n\"b\n", "line 2: a quote"),
            ("--quality draft\n", "line 1: begins with no path"),
            ("a\0b\n", "zero byte"),
        ] {
            let e = list_of(text).expect_err("refused");
            assert!(e.exit_code() == 2 && e.to_string().contains(said), "{e}");
        }
    }

    #[test]
    fn a_folder_lists_its_sub_folders_but_not_the_output() {
        let dir = tempfile::tempdir().expect("temp");
        for name in ["b", "a", ".hidden", "out"] {
            std::fs::create_dir(dir.path().join(name)).expect("folder");
        }
        std::fs::write(dir.path().join("notes.txt"), b"x").expect("file");
        let items = read_list(dir.path(), &dir.path().join("out")).expect("a list");
        assert_eq!(names(&items), ["a", "b"]);
        std::fs::write(dir.path().join("transforms.json"), b"{}").expect("file");
        let e = read_list(dir.path(), &dir.path().join("out")).expect_err("a scene");
        assert!(e.to_string().contains("itself a scene"), "{e}");
    }
}

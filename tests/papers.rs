//! The documents against the code: what they cite exists, what they show can be read.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

fn read(path: impl AsRef<Path>) -> String {
    let path = root().join(path);
    std::fs::read_to_string(&path).unwrap_or_else(|e| panic!("{}: {e}", path.display()))
}

/// All files below `folder` with one of these extensions.
fn files(folder: &str, extensions: &[&str]) -> Vec<PathBuf> {
    let (mut folders, mut found) = (vec![root().join(folder)], Vec::new());
    while let Some(folder) = folders.pop() {
        for entry in std::fs::read_dir(folder).into_iter().flatten().flatten() {
            let path = entry.path();
            if path.is_dir() {
                folders.push(path);
            } else if path
                .extension()
                .is_some_and(|e| extensions.iter().any(|x| e == *x))
            {
                found.push(path);
            }
        }
    }
    found.sort();
    found
}

/// The documents: at the root and below docs/.
fn papers() -> Vec<PathBuf> {
    let mut found = files("docs", &["md"]);
    found.extend(["README.md", "CHANGELOG.md", "CONTRIBUTING.md"].map(|n| root().join(n)));
    found
}

/// The anchor that a heading gets on the usual sites.
fn anchor(heading: &str) -> String {
    heading
        .trim()
        .to_lowercase()
        .chars()
        .filter(|c| c.is_alphanumeric() || matches!(c, ' ' | '-' | '_'))
        .map(|c| if c == ' ' { '-' } else { c })
        .collect()
}

fn headings(text: &str) -> Vec<&str> {
    text.lines()
        .filter(|l| l.starts_with('#'))
        .map(|l| l.trim_start_matches('#').trim())
        .collect()
}

#[test]
fn what_the_code_cites_of_the_method_is_there() {
    let method = read("docs/method.md");
    let numbers: BTreeSet<&str> = headings(&method)
        .iter()
        .filter_map(|h| h.split_whitespace().next())
        .collect();
    assert!(numbers.contains("12.3") && numbers.contains("4.1"));
    let mut cited = 0;
    for folder in ["src", "tests", "benches", "examples"] {
        for path in files(folder, &["rs"]) {
            if path.ends_with("tests/papers.rs") {
                continue;
            }
            let text = std::fs::read_to_string(&path).expect("source");
            // a citation may be broken over two lines of a comment
            let text = text.replace("\n//! ", " ").replace("\n    /// ", " ");
            let text = text.replace("\n/// ", " ");
            for part in text.split("method §").skip(1) {
                let end = part
                    .find(|c: char| !c.is_ascii_digit() && c != '.')
                    .unwrap_or(part.len());
                let number = part[..end].trim_end_matches('.');
                assert!(
                    numbers.contains(number),
                    "{}: method §{number} is not in docs/method.md",
                    path.display()
                );
                cited += 1;
            }
            for elsewhere in ["design §", "(CHANGELOG)", "CHANGELOG)"] {
                assert!(
                    !text.contains(elsewhere),
                    "{}: cites {elsewhere}; name a page of docs/",
                    path.display()
                );
            }
        }
    }
    assert!(cited > 10, "only {cited} citations found");
}

#[test]
fn links_lead_somewhere() {
    for path in papers() {
        let text = std::fs::read_to_string(&path).expect("paper");
        for part in text.split("](").skip(1) {
            let target = part.split(')').next().unwrap_or_default();
            if target.is_empty() || target.contains("://") {
                continue;
            }
            let (file, fragment) = target.split_once('#').unwrap_or((target, ""));
            let to = if file.is_empty() {
                path.clone()
            } else {
                path.with_file_name("").join(file)
            };
            assert!(to.exists(), "{}: {target} is missing", path.display());
            if !fragment.is_empty() {
                let linked = std::fs::read_to_string(&to).expect("text");
                assert!(
                    headings(&linked).iter().any(|h| anchor(h) == fragment),
                    "{}: no heading #{fragment} in {file}",
                    path.display()
                );
            }
        }
    }
}

#[test]
fn readme_is_short_and_no_paper_names_a_machine() {
    let lines = read("README.md").lines().count();
    assert!(lines <= 150, "README.md has {lines} lines");
    for path in papers() {
        let text = std::fs::read_to_string(&path).expect("paper");
        for place in ["/work/", "/root/", "crates.io", "pypi.org", "npmjs"] {
            assert!(!text.contains(place), "{}: {place}", path.display());
        }
    }
}

#[test]
fn files_that_architecture_names_exist() {
    let text = read("docs/architecture.md");
    let table = text
        .split("## Where is …?")
        .nth(1)
        .and_then(|t| t.split("\n## ").next())
        .expect("the table");
    let mut named = 0;
    for name in table.split('`').skip(1).step_by(2) {
        if name.ends_with(".rs") {
            named += 1;
            let beside = root().join("src").join(name);
            assert!(beside.exists(), "docs/architecture.md: src/{name}");
        }
    }
    assert!(named > 15);
}

/// Keys that the reader of `transforms.json` asks for.
fn keys_read() -> BTreeSet<String> {
    let source = read("src/scene/transforms.rs");
    let code = source.split("#[cfg(test)]").next().unwrap_or_default();
    let asks = ["text(", "number(", "names(", "get(", "side("];
    let mut keys = BTreeSet::new();
    for (i, _) in code.match_indices('"') {
        let before = code[..i].trim_end();
        let literal = code[i + 1..].split('"').next().unwrap_or_default();
        let plain = literal
            .bytes()
            .all(|c| c.is_ascii_lowercase() || c.is_ascii_digit() || c == b'_');
        if plain && !literal.is_empty() && asks.iter().any(|a| before.ends_with(a)) {
            keys.insert(literal.to_owned());
        }
    }
    assert!(keys.len() > 12, "{keys:?}");
    keys
}

#[test]
fn every_key_of_a_scene_is_documented_and_every_documented_key_is_read() {
    let (page, source) = (
        read("docs/scene-format.md"),
        read("src/scene/transforms.rs"),
    );
    for key in keys_read() {
        assert!(
            page.contains(&format!("`{key}`")) || page.contains(&format!("\"{key}\"")),
            "docs/scene-format.md lacks the key {key}"
        );
    }
    let tables = page.split("## Ground truth").next().unwrap_or_default();
    for line in tables.lines().filter(|l| l.starts_with("| `")) {
        let cell = line.split('|').nth(1).unwrap_or_default();
        for key in cell.split('`').skip(1).step_by(2) {
            assert!(
                source.contains(&format!("\"{key}\"")),
                "docs/scene-format.md documents {key}, which nothing reads"
            );
        }
    }
}

#[test]
fn the_example_scene_is_understood() {
    let scene = unbake::scene::transforms::parse_transforms(&read("docs/examples/transforms.json"))
        .unwrap_or_else(|issues| panic!("{issues:#?}"));
    assert_eq!(scene.frames.len(), 3);
    assert_eq!(scene.mesh_path, "mesh.glb");
    let classes = scene.classes.expect("classes");
    assert!(classes.iter().any(|c| c.name == "lamp" && c.is_light));
    assert_eq!(scene.test.expect("split"), ["images/002.exr"]);
    // the second camera looks along -x: its backward axis, the third column, is +x
    let backward = scene.frames[1].rotation.z_axis;
    assert!((backward.x - 1.0).abs() < 1e-9, "{backward}");
}

#[test]
fn the_examples_of_edits_and_lights_are_understood() {
    let edits = unbake::programs::edit::EditList::read(&root().join("docs/examples/edits.toml"));
    assert_eq!(edits.expect("edits").edits.len(), 3);
    let lights = unbake::render::Lighting::read(&root().join("docs/examples/lights.toml"));
    let lights = lights.expect("lights");
    assert_eq!((lights.lamps.len(), lights.add.len()), (2, 2));
}

/// Output of a script of this repository, which must end well; `None` where no Python is installed.
fn script(arguments: &[&str]) -> Option<String> {
    let Ok(done) = std::process::Command::new("python3")
        .args(arguments)
        .current_dir(root())
        .output()
    else {
        eprintln!("skipped: python3 is not installed");
        return None;
    };
    assert!(
        done.status.success(),
        "{arguments:?}: {}",
        String::from_utf8_lossy(&done.stderr)
    );
    Some(String::from_utf8(done.stdout).expect("text"))
}

#[test]
fn counts_of_the_code_only_fall() {
    let Some(text) = script(&["scripts/measure_code"]) else {
        return;
    };
    let counts: serde_json::Value = serde_json::from_str(&text).expect("JSON");
    for (what, most) in [
        ("functions_over_80", 0),
        ("parameter_lists_over_6", 0),
        ("file_circles", 0),
        ("constants", 70),
        ("constants_without_source", 0),
    ] {
        let found = counts[what].as_u64().expect(what);
        assert!(
            found <= most,
            "{found} {what}, {most} at most; scripts/measure_code --list names them"
        );
    }
}

#[test]
fn what_comments_claim_of_sensitivity_was_measured() {
    script(&["scripts/sensitivity", "--check"]);
}

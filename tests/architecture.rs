//! The module table of the design, checked against the code: who may use whom, where `unsafe`
//! lives, how long a file gets.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

/// What may be used by all of the story: types, filters, formats, rays.
const VOCABULARY: [&str; 20] = [
    "blocks", "lock", "memory", "network", "brdf", "texture", "trace", "stats", "metrics", "image",
    "geometry", "formats", "sampling", "math", "parallel", "progress", "switch", "verdict",
    "error", "ffi",
];

/// Module, and what it may use beyond `error`; "vocabulary" stands for all of [`VOCABULARY`].
const TABLE: &[(&str, &[&str])] = &[
    ("cli", &["pipeline", "story", "vocabulary"]),
    ("bench", &["pipeline", "story", "vocabulary"]),
    ("view", &["pipeline", "story", "vocabulary"]),
    (
        "pipeline",
        &[
            "scene",
            "gbuffer",
            "observed",
            "radiance",
            "lights",
            "specular",
            "irradiance",
            "highlight",
            "inverse",
            "published",
            "solution",
            "vocabulary",
        ],
    ),
    (
        "published",
        &["gbuffer", "observed", "radiance", "lights", "vocabulary"],
    ),
    ("alignment", &["scene", "gbuffer", "vocabulary"]),
    (
        "report",
        &[
            "alignment",
            "scene",
            "evaluate",
            "export",
            "render",
            "solution",
            "vocabulary",
        ],
    ),
    (
        "export",
        &["scene", "evaluate", "render", "solution", "vocabulary"],
    ),
    (
        "bake",
        &[
            "scene",
            "irradiance",
            "radiance",
            "render",
            "pipeline",
            "vocabulary",
        ],
    ),
    ("batch", &["report", "solution", "vocabulary"]),
    (
        "run",
        &[
            "alignment",
            "scene",
            "report",
            "pipeline",
            "render",
            "solution",
            "vocabulary",
        ],
    ),
    ("shards", &["vocabulary"]),
    ("evaluate", &["render", "scene", "solution", "vocabulary"]),
    (
        "edit",
        &[
            "scene",
            "radiance",
            "lights",
            "irradiance",
            "gbuffer",
            "render",
            "solution",
            "vocabulary",
        ],
    ),
    (
        "synth",
        &[
            "scene",
            "irradiance",
            "radiance",
            "render",
            "solution",
            "vocabulary",
        ],
    ),
    (
        "render",
        &[
            "scene",
            "irradiance",
            "radiance",
            "lights",
            "specular",
            "gbuffer",
            "solution",
            "vocabulary",
        ],
    ),
    (
        "inverse",
        &[
            "scene",
            "observed",
            "radiance",
            "lights",
            "specular",
            "gbuffer",
            "highlight",
            "vocabulary",
        ],
    ),
    (
        "highlight",
        &[
            "scene",
            "observed",
            "lights",
            "specular",
            "gbuffer",
            "vocabulary",
        ],
    ),
    (
        "irradiance",
        &["lights", "specular", "radiance", "vocabulary"],
    ),
    (
        "specular",
        &["observed", "lights", "radiance", "vocabulary"],
    ),
    ("lights", &["radiance", "vocabulary"]),
    ("radiance", &["gbuffer", "vocabulary"]),
    ("observed", &["gbuffer", "scene", "vocabulary"]),
    ("gbuffer", &["scene", "vocabulary"]),
    ("prepare", &["scene", "vocabulary"]),
    ("solution", &["vocabulary"]),
    ("scene", &["vocabulary"]),
    ("brdf", &["math", "sampling", "ffi"]),
    ("texture", &["image", "geometry", "math", "parallel"]),
    ("trace", &["geometry", "sampling", "parallel", "ffi"]),
    ("stats", &["image", "math", "parallel"]),
    ("metrics", &["image", "math", "parallel"]),
    ("formats", &["image", "geometry", "math", "parallel", "ffi"]),
    ("network", &["math", "sampling", "parallel", "ffi"]),
    ("image", &["math"]),
    ("geometry", &["math"]),
    ("sampling", &["math"]),
    ("switch", &[]),
    ("math", &[]),
    ("parallel", &["ffi"]),
    ("progress", &["blocks", "parallel"]),
    ("blocks", &["formats", "lock", "parallel"]),
    ("lock", &[]),
    ("memory", &["formats", "parallel"]),
    ("verdict", &[]),
    ("error", &[]),
    ("ffi", &[]),
];

/// Edges that break the table today. Each must still exist: whoever mends one takes it off the
/// list.
const DEBTS: [(&str, &str); 0] = [];

/// Files beyond the limit today, and how far they may go.
const LONG_FILES: [(&str, usize); 0] = [];

const MOST_LINES: usize = 1150;

/// Folders that only hold rooms.
const GROUPS: [&str; 2] = ["core", "programs"];

fn sources() -> Vec<(PathBuf, String)> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let mut folders = vec![root.join("src")];
    let mut found = Vec::new();
    while let Some(folder) = folders.pop() {
        for entry in std::fs::read_dir(folder).expect("src can be listed") {
            let path = entry.expect("entry").path();
            if path.is_dir() {
                folders.push(path);
            } else if path.extension().is_some_and(|e| e == "rs") {
                let text = std::fs::read_to_string(&path).expect("source");
                found.push((
                    path.strip_prefix(root)
                        .expect("below the root")
                        .to_path_buf(),
                    text,
                ));
            }
        }
    }
    found.sort();
    assert!(found.len() > 50);
    found
}

/// The code a build has: no comments, no test modules (they stand last in a file), no files of
/// tests.
fn code(path: &Path, text: &str) -> Option<String> {
    if path
        .file_name()
        .is_some_and(|n| n.to_string_lossy().contains("tests"))
    {
        return None;
    }
    let end = text
        .find("#[cfg(test)]\nmod tests {")
        .or_else(|| text.find("#[cfg(test)]\npub(crate) mod tests {"));
    let lines = text[..end.unwrap_or(text.len())]
        .lines()
        .filter(|l| !l.trim_start().starts_with("//"));
    Some(lines.collect::<Vec<_>>().join("\n"))
}

/// The room of a file: the folder below `src`, or below the groups `core` and `programs`.
fn module_of(path: &Path) -> Option<String> {
    let mut names = path.components().skip(1).map(|c| {
        let name = c.as_os_str().to_string_lossy();
        name.trim_end_matches(".rs").to_owned()
    });
    let mut name = names.next()?;
    if GROUPS.contains(&name.as_str()) {
        name = names.next()?;
    }
    (name != "lib" && name != "main" && name != "mod").then_some(name)
}

/// First path segments after every `crate::` of a text, groups in braces included.
fn uses(code: &str) -> BTreeSet<String> {
    let word = |s: &str| {
        s.chars()
            .take_while(|c| c.is_alphanumeric() || *c == '_')
            .collect::<String>()
    };
    let mut out = BTreeSet::new();
    for (at, _) in code.match_indices("crate::") {
        let rest = &code[at + 7..];
        if let Some(group) = rest.strip_prefix('{') {
            let (mut depth, mut start) = (0, true);
            for (i, c) in group.char_indices() {
                match c {
                    '{' => depth += 1,
                    '}' if depth == 0 => break,
                    '}' => depth -= 1,
                    ',' if depth == 0 => start = true,
                    c if c.is_whitespace() => {}
                    _ if start => {
                        out.insert(word(&group[i..]));
                        start = false;
                    }
                    _ => {}
                }
            }
        } else {
            let first = word(rest);
            let in_group = GROUPS.contains(&first.as_str());
            out.insert(if in_group {
                word(rest[first.len()..].trim_start_matches(':'))
            } else {
                first
            });
        }
    }
    out.into_iter()
        .map(|u| {
            if u == "Error" || u == "Result" {
                "error".into()
            } else {
                u
            }
        })
        .collect()
}

fn graph() -> BTreeMap<String, BTreeMap<String, PathBuf>> {
    let mut graph: BTreeMap<String, BTreeMap<String, PathBuf>> = BTreeMap::new();
    for (path, text) in sources() {
        if let (Some(module), Some(code)) = (module_of(&path), code(&path, &text)) {
            let edges = graph.entry(module.clone()).or_default();
            for used in uses(&code).into_iter().filter(|u| *u != module) {
                edges.entry(used).or_insert_with(|| path.clone());
            }
        }
    }
    graph
}

#[test]
fn modules_use_what_the_table_allows() {
    let allowed: BTreeMap<&str, &[&str]> = TABLE.iter().copied().collect();
    let story: Vec<&str> = TABLE
        .iter()
        .map(|t| t.0)
        .filter(|m| !VOCABULARY.contains(m) && *m != "cli" && *m != "pipeline")
        .collect();
    let mut wrong = Vec::new();
    for (module, edges) in graph() {
        let Some(may) = allowed.get(module.as_str()) else {
            wrong.push(format!("module {module} is not in the table"));
            continue;
        };
        for (used, path) in edges {
            let u = used.as_str();
            let fine = u == "error"
                || may.contains(&u)
                || (may.contains(&"vocabulary") && VOCABULARY.contains(&u))
                || (may.contains(&"story") && story.contains(&u))
                || DEBTS.contains(&(module.as_str(), u));
            if !fine {
                wrong.push(format!("{module} may not use {used} ({})", path.display()));
            }
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

#[test]
fn there_are_no_cycles() {
    let mut left = graph();
    for (from, to) in DEBTS {
        let removed = left.get_mut(from).and_then(|e| e.remove(to));
        assert!(
            removed.is_some(),
            "{from} uses {to} no longer: take the pair off the list of debts"
        );
    }
    loop {
        let free: Vec<String> = left
            .iter()
            .filter(|(_, e)| e.keys().all(|u| !left.contains_key(u)))
            .map(|(m, _)| m.clone())
            .collect();
        if free.is_empty() {
            break;
        }
        left.retain(|m, _| !free.contains(m));
    }
    assert!(
        left.is_empty(),
        "cycle among {:?}",
        left.keys().collect::<Vec<_>>()
    );
}

#[test]
fn unsafe_lives_at_the_border_and_explains_itself() {
    for (path, text) in sources() {
        let lines: Vec<&str> = text.lines().collect();
        for (i, line) in lines.iter().enumerate() {
            let statement = line.split("//").next().unwrap_or_default();
            let words: Vec<&str> = statement
                .split(|c: char| !c.is_alphanumeric() && c != '_')
                .collect();
            if !words.contains(&"unsafe") {
                continue;
            }
            assert!(
                path.starts_with("src/ffi"),
                "{}:{}: unsafe outside src/ffi",
                path.display(),
                i + 1
            );
            if statement.contains("unsafe {") || statement.contains("unsafe impl") {
                let near = &lines[i.saturating_sub(8)..=i];
                assert!(
                    near.iter().any(|l| l.contains("SAFETY")),
                    "{}:{}: no SAFETY comment",
                    path.display(),
                    i + 1
                );
            }
        }
    }
}

#[test]
fn files_stay_readable() {
    for (path, text) in sources() {
        let (name, lines) = (path.display().to_string(), text.lines().count());
        match LONG_FILES.iter().find(|f| f.0 == name) {
            Some((_, most)) => {
                assert!(
                    lines > MOST_LINES,
                    "{name} is short again: take it off the list"
                );
                assert!(
                    lines <= *most,
                    "{name} has {lines} lines and grows; split it"
                );
            }
            None => assert!(lines <= MOST_LINES, "{name} has {lines} lines; split it"),
        }
        assert!(
            text.starts_with("//!"),
            "{name} does not say what it is for"
        );
    }
}

/// The solver must never look at the ground truth.
#[test]
fn only_evaluation_and_synthesis_know_of_ground_truth() {
    for (path, text) in sources() {
        let module = module_of(&path).unwrap_or_default();
        if [
            "pipeline",
            "inverse",
            "highlight",
            "irradiance",
            "gbuffer",
            "texture",
        ]
        .contains(&module.as_str())
        {
            let code = code(&path, &text).unwrap_or_default();
            assert!(
                !code.contains("\"gt") && !code.contains("gt/"),
                "{} names the ground truth",
                path.display()
            );
        }
    }
}

/// Paths that a file's code names, as files of `src` (`super` and `self` resolved); what a `mod.rs`
/// passes on is looked for no further.
fn files_used(path: &Path, code: &str, files: &BTreeSet<PathBuf>) -> BTreeSet<PathBuf> {
    let own: Vec<String> = {
        let text = path.with_extension("");
        let parts = text.components().skip(1);
        parts
            .map(|c| c.as_os_str().to_string_lossy().into_owned())
            .filter(|c| c != "mod")
            .collect()
    };
    let mut out = BTreeSet::new();
    for (at, _) in code.match_indices("::") {
        let start = code[..at]
            .rfind(|c: char| !(c.is_alphanumeric() || c == '_' || c == ':'))
            .map_or(0, |i| i + 1);
        let text: String = code[start..]
            .chars()
            .take_while(|c| c.is_alphanumeric() || *c == '_' || *c == ':')
            .collect();
        let mut segments = text.split("::").peekable();
        let mut place = own.clone();
        match segments.peek() {
            Some(&"crate") => {
                segments.next();
                place.clear();
            }
            Some(&"super") => {
                while segments.next_if_eq(&"super").is_some() {
                    place.pop();
                }
            }
            _ => continue,
        }
        let mut found = None;
        for s in segments {
            place.push(s.to_owned());
            let base: PathBuf = std::iter::once("src".to_owned())
                .chain(place.iter().cloned())
                .collect();
            found = files.get(&base.with_extension("rs")).cloned().or(found);
        }
        out.extend(found.filter(|f| f != path));
    }
    out
}

#[test]
fn files_do_not_run_in_circles() {
    let sources = sources();
    let files: BTreeSet<PathBuf> = sources.iter().map(|s| s.0.clone()).collect();
    let mut left: BTreeMap<PathBuf, BTreeSet<PathBuf>> = sources
        .iter()
        .filter_map(|(path, text)| {
            let code = code(path, text)?;
            Some((path.clone(), files_used(path, &code, &files)))
        })
        .collect();
    assert!(left.values().map(BTreeSet::len).sum::<usize>() > 100);
    // files that use no other that is left stand on the ground; what never gets there is a circle
    loop {
        let grounded: Vec<PathBuf> = left
            .iter()
            .filter(|(_, used)| used.iter().all(|u| !left.contains_key(u)))
            .map(|(path, _)| path.clone())
            .collect();
        if grounded.is_empty() {
            break;
        }
        grounded.iter().for_each(|path| {
            left.remove(path);
        });
    }
    let circles: Vec<String> = left
        .iter()
        .map(|(path, used)| format!("{} -> {used:?}", path.display()))
        .collect();
    assert!(circles.is_empty(), "{}", circles.join("\n"));
}

/// The packages a build of `selection` takes, a line each with version and features.
fn packages(selection: &[&str]) -> Result<BTreeSet<String>, String> {
    let done = std::process::Command::new(env!("CARGO"))
        .current_dir(env!("CARGO_MANIFEST_DIR"))
        .args(["tree", "--locked", "--prefix", "none", "--no-dedupe"])
        .args(["--format", "{p} {f}"])
        .args(selection)
        .output()
        .map_err(|e| e.to_string())?;
    if !done.status.success() {
        return Err(String::from_utf8_lossy(&done.stderr).into_owned());
    }
    let text = String::from_utf8_lossy(&done.stdout);
    Ok(text.lines().map(str::to_owned).collect())
}

/// Cargo builds a package again, and all above it, for another set of features: so the program, its
/// tests and the Python module must ask for the same ones.
#[test]
fn program_tests_and_module_share_one_build() {
    let program = packages(&["--edges", "normal,build"]).expect("cargo tree knows the program");
    assert!(program.len() > 100, "{} packages", program.len());
    let tests = packages(&["--edges", "normal,build,dev"]).expect("cargo tree knows the tests");
    let mut others = vec![("the tests", tests)];
    match packages(&["--edges", "normal,build", "--package", "unbake-python"]) {
        Ok(module) => others.push(("the Python module", module)),
        Err(why) => eprintln!("skipped: cargo does not know the module's packages: {why}"),
    }
    for (who, packages) in others {
        let differ: Vec<_> = program.difference(&packages).collect();
        assert!(differ.is_empty(), "{who} ask other features of {differ:?}");
    }
}

/// Cargo loads the manifest and the sources of every member of a workspace, whichever it builds.
#[test]
fn the_container_is_given_every_member() {
    let read = |name: &str| {
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join(name);
        std::fs::read_to_string(&path).unwrap_or_else(|e| panic!("{}: {e}", path.display()))
    };
    let manifest: toml::Value = toml::from_str(&read("Cargo.toml")).expect("TOML");
    let members = manifest["workspace"]["members"].as_array().expect("a list");
    let container = read("Containerfile");
    for member in members.iter().map(|m| m.as_str().expect("a folder")) {
        for line in [
            format!("COPY {member}/Cargo.toml {member}/"),
            format!("COPY {member}/src {member}/src"),
        ] {
            assert!(container.lines().any(|l| l == line), "it lacks: {line}");
        }
    }
}

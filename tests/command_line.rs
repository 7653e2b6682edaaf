//! The program as a user meets it: exit codes, messages, pipes.

use std::process::{Command, Output, Stdio};

fn unbake(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_unbake"))
        .args(arguments)
        .output()
        .expect("the program starts")
}

fn text(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).into_owned()
}

#[test]
fn help_and_version_are_results() {
    let version = unbake(&["--version"]);
    assert_eq!(version.status.code(), Some(0));
    let shown = text(&version.stdout);
    assert!(
        shown.starts_with("unbake ")
            && shown.contains("\nEmbree ")
            && shown.contains("\nOpenImageIO "),
        "{shown}"
    );
    let help = unbake(&["solve", "--help"]);
    assert_eq!((help.status.code(), help.stderr.len()), (Some(0), 0));
    assert!(text(&help.stdout).contains("--albedo-size"));
}

#[test]
fn shells_and_man_know_every_verb() {
    for shell in ["bash", "zsh", "fish"] {
        let out = unbake(&["completions", shell]);
        assert_eq!(out.status.code(), Some(0), "{shell}");
        assert!(text(&out.stdout).contains("relight"), "{shell}");
    }
    let page = text(&unbake(&["man"]).stdout);
    assert!(page.contains(".TH") && page.contains("relight"), "{page}");
    let folder = tempfile::tempdir().expect("temp");
    let to = folder.path().to_string_lossy().into_owned();
    assert_eq!(unbake(&["man", "--to", &to]).status.code(), Some(0));
    let solve = std::fs::read_to_string(folder.path().join("unbake-solve.1")).expect("a page");
    assert!(
        solve.contains("albedo\\-size") && solve.contains("threads"),
        "{solve}"
    );
}

#[test]
fn wrong_usage_is_2_and_says_what_to_do() {
    for arguments in [
        &[][..],
        &["nonsense"],
        &["solve"],
        &["solve", "x", "-o", "y", "--no-such-flag"],
        &["--threads", "0", "check", "x"],
        &["solve", "x", "-o", "y", "--albedo-size", "many"],
    ] {
        let out = unbake(arguments);
        assert_eq!(
            out.status.code(),
            Some(2),
            "{arguments:?}: {}",
            text(&out.stderr)
        );
        assert!(
            !out.stderr.is_empty() && out.stdout.is_empty(),
            "{arguments:?}"
        );
    }
}

#[test]
fn unusable_input_is_2_and_names_the_file() {
    let folder = tempfile::tempdir().expect("temp");
    let scene = folder.path().join("scene");
    std::fs::create_dir(&scene).expect("folder");
    let (scene_text, out) = (scene.to_str().expect("utf-8"), folder.path().join("out"));
    let missing = unbake(&["solve", scene_text, "-o", out.to_str().expect("utf-8")]);
    assert_eq!(missing.status.code(), Some(2));
    assert!(
        text(&missing.stderr).contains("transforms.json"),
        "{}",
        text(&missing.stderr)
    );
    assert!(!out.exists(), "nothing is left behind");
    let check = unbake(&["check", scene_text]);
    assert_eq!(check.status.code(), Some(2));
    assert!(text(&check.stdout).contains("transforms.json"));
    let eval = unbake(&["eval", out.to_str().expect("utf-8"), "--scene", scene_text]);
    assert_eq!(eval.status.code(), Some(2));
    assert!(
        text(&eval.stderr).contains("unbake solve"),
        "{}",
        text(&eval.stderr)
    );
}

#[test]
fn with_json_stdout_is_one_json_object_even_for_errors() {
    let folder = tempfile::tempdir().expect("temp");
    let file = folder.path().join("unbake.toml");
    std::fs::write(&file, "json = true\n").expect("file");
    let by_file = ["--config", file.to_str().expect("utf-8")];
    for asked in [&["--json"][..], &by_file] {
        let verb = ["--quiet", "eval", "/nonexistent", "--scene", "/nonexistent"];
        let out = unbake(&[asked, &verb].concat());
        assert_eq!(out.status.code(), Some(2));
        let json: serde_json::Value = serde_json::from_slice(&out.stdout).expect("JSON");
        assert_eq!(json["exit_code"], 2);
        let said = json["error"].as_str().expect("message");
        assert!(said.contains("/nonexistent"), "{said}");
    }
}

#[test]
fn a_configuration_is_printed_with_what_was_typed_and_reads_back() {
    let folder = tempfile::tempdir().expect("temp");
    let out = unbake(&[
        "solve",
        "--albedo-size",
        "333",
        "--threads",
        "1",
        "--print-config",
    ]);
    assert_eq!(out.status.code(), Some(0), "{}", text(&out.stderr));
    let printed = text(&out.stdout);
    assert!(
        printed.contains("albedo-size = 333") && printed.contains("threads = 1"),
        "{printed}"
    );
    let file = folder.path().join("c.toml");
    std::fs::write(&file, &printed).expect("writes");
    let path = file.to_str().expect("utf-8");
    let again = unbake(&["solve", "--config", path, "--print-config"]);
    assert_eq!(text(&again.stdout), printed);
    let overridden = unbake(&[
        "solve",
        "--config",
        path,
        "--albedo-size",
        "334",
        "--print-config",
    ]);
    assert!(text(&overridden.stdout).contains("albedo-size = 334"));
    std::fs::write(&file, "[solve]\nalbedo-sise = 3\n").expect("writes");
    let misspelt = unbake(&["solve", "--config", path, "--print-config"]);
    assert_eq!(misspelt.status.code(), Some(2));
    assert!(text(&misspelt.stderr).contains("albedo-sise"));
}

#[test]
fn a_reader_that_leaves_early_is_no_failure() {
    let mut child = Command::new(env!("CARGO_BIN_EXE_unbake"))
        .arg("--print-config")
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .expect("starts");
    drop(child.stdout.take());
    let out = child.wait_with_output().expect("ends");
    assert_eq!(out.status.code(), Some(0), "{}", text(&out.stderr));
}

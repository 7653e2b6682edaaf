//! `unbake batch`: processes that share scenes, are killed, and meet what cannot be solved.

use serde_json::Value;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};
use std::sync::OnceLock;
use std::time::{Duration, Instant};

/// Flags that make a reconstruction of the tiny scene as small as it gets.
const TINY: [&str; 12] = [
    "--quality",
    "draft",
    "--albedo-size",
    "64",
    "--roughness-size",
    "64",
    "--irradiance-size",
    "32",
    "--irradiance-rays",
    "8",
    "--emitter-samples",
    "4",
];

fn unbake(arguments: &[&str]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_unbake"));
    command
        .args(arguments)
        .env_remove("SLURM_ARRAY_TASK_ID")
        .env_remove("AWS_BATCH_JOB_ARRAY_INDEX")
        .stdin(Stdio::null());
    command
}

fn batch(list: &Path, out: &Path, more: &[&str]) -> Command {
    let mut command = unbake(&["--threads", "1", "batch"]);
    command.arg(list).arg("-o").arg(out).args(TINY).args(more);
    command
}

fn run(mut command: Command) -> (Option<i32>, String) {
    let Output {
        status,
        stdout,
        stderr,
    } = command.output().expect("the program starts");
    let said = [stdout, stderr].concat();
    (status.code(), String::from_utf8_lossy(&said).into_owned())
}

/// A synthetic room of three small views, made once.
fn room() -> &'static Path {
    static ROOM: OnceLock<PathBuf> = OnceLock::new();
    ROOM.get_or_init(|| {
        let scene = PathBuf::from(env!("CARGO_TARGET_TMPDIR")).join("batch-room");
        let _ = fs::remove_dir_all(&scene);
        let size = "--rooms 1 --views 3 --test-views 1 --width 64 --spp 1 --texture 64";
        let mut synth = unbake(&["synth", "-o"]);
        synth.arg(&scene).args(size.split(' '));
        let (code, said) = run(synth);
        assert_eq!(code, Some(0), "{said}");
        scene
    })
}

fn copied(from: &Path, to: &Path) {
    fs::create_dir_all(to).expect("folder");
    for entry in fs::read_dir(from).expect("lists") {
        let entry = entry.expect("entry");
        let target = to.join(entry.file_name());
        match entry.path().is_dir() {
            true => copied(&entry.path(), &target),
            false => drop(fs::copy(entry.path(), target).expect("copied")),
        }
    }
}

/// Copies of the room under `names`, in a folder `scenes` of `dir`.
fn scenes(dir: &Path, names: &[&str]) {
    for name in names {
        copied(room(), &dir.join("scenes").join(name));
    }
}

fn list(dir: &Path, lines: &str) -> PathBuf {
    let path = dir.join("list.txt");
    fs::write(&path, lines).expect("written");
    path
}

fn table(out: &Path) -> Value {
    let text = fs::read(out.join("batch.json")).expect("a merged report");
    serde_json::from_slice(&text).expect("JSON")
}

fn states(table: &Value) -> Vec<&str> {
    let rows = table["scenes"].as_array().expect("rows");
    rows.iter()
        .map(|r| r["state"].as_str().expect("a state"))
        .collect()
}

fn attempts(table: &Value) -> Vec<u64> {
    let rows = table["scenes"].as_array().expect("rows");
    rows.iter()
        .map(|r| r["attempts"].as_u64().expect("a number"))
        .collect()
}

fn wait_for(what: &str, holds: impl Fn() -> bool) {
    let start = Instant::now();
    while !holds() {
        assert!(
            start.elapsed() < Duration::from_secs(240),
            "{what}: not seen"
        );
        std::thread::sleep(Duration::from_millis(2));
    }
}

/// Ends a process as the kernel's killer does: without a chance to tidy up.
fn kill(mut child: Child) {
    child.kill().expect("killed");
    child.wait().expect("gone");
}

#[test]
fn two_processes_share_a_list_and_solve_each_scene_once() {
    let dir = tempfile::tempdir().expect("temp");
    scenes(dir.path(), &["a", "b", "c", "d"]);
    let (list, out) = (dir.path().join("scenes"), dir.path().join("out"));
    let start = || {
        let mut command = batch(&list, &out, &["--quiet"]);
        command.stdout(Stdio::null()).spawn().expect("starts")
    };
    let workers = [start(), start()];
    let ids = workers.each_ref().map(Child::id);
    for mut worker in workers {
        assert!(worker.wait().expect("ends").success());
    }
    let merged = table(&out);
    assert_eq!(states(&merged), ["finished"; 4], "{merged:#}");
    assert_eq!(attempts(&merged), [1; 4]);
    for id in ids {
        let own = format!(":{id}");
        let rows = merged["scenes"].as_array().expect("rows");
        let count = rows
            .iter()
            .filter(|r| r["worker"].as_str().is_some_and(|w| w.ends_with(&own)))
            .count();
        assert!((1..4).contains(&count), "{id}: {merged:#}");
    }
    let row = &merged["scenes"][2];
    assert!(row["seconds"].as_f64().is_some_and(|s| s > 0.0), "{row}");
    assert!(row["peak_bytes"].as_u64().is_some_and(|b| b > 1 << 20));
    assert!(row["expected_error"].as_f64().is_some() && row["verdict"].is_string());
    assert!(out.join("c/scene.glb").is_file() && out.join("c/report.html").is_file());
    let text = fs::read_to_string(out.join("batch.md")).expect("a table");
    assert_eq!(text.matches("| finished |").count(), 4, "{text}");
    // the same bits as `solve` gives
    let single = dir.path().join("single");
    let mut solve = unbake(&["solve", "--threads", "1"]);
    solve.arg(list.join("c")).arg("-o").arg(&single).args(TINY);
    assert_eq!(run(solve).0, Some(0));
    let pixels = |folder: &Path| {
        let image = unbake::core::formats::read_rgb(folder.join("albedo.exr"));
        image.expect("an image").data
    };
    assert_eq!(pixels(&single), pixels(&out.join("c")));
}

#[test]
fn what_was_killed_goes_on_and_what_was_finished_stays() {
    let dir = tempfile::tempdir().expect("temp");
    scenes(dir.path(), &["a", "b"]);
    let (list, out) = (dir.path().join("scenes"), dir.path().join("out"));
    // enough rays for the kill to fall between the checkpoint and the end
    let more = ["--specular-rays", "64"];
    let child = batch(&list, &out, &more)
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn()
        .expect("starts");
    let kept = |name: &str, file: &str| {
        let runs = fs::read_dir(out.join(name).join(".partial"));
        runs.is_ok_and(|r| r.flatten().any(|run| run.path().join(file).is_file()))
    };
    wait_for("irradiance of b", || kept("b", "irradiance"));
    kill(child);
    let state = |name: &str| -> Value {
        let text = fs::read(out.join(".batch").join(name).join("state.json")).expect("a state");
        serde_json::from_slice(&text).expect("JSON")
    };
    assert_eq!(
        (&state("a")["state"], &state("b")["state"]),
        (&"finished".into(), &"started".into())
    );
    let (code, said) = run(batch(&list, &out, &more));
    assert_eq!(code, Some(0), "{said}");
    assert!(
        said.contains("(a) of 2: finished already")
            && said.contains("irradiance: taken over from the run that stopped"),
        "{said}"
    );
    let merged = table(&out);
    assert_eq!(states(&merged), ["finished"; 2]);
    assert_eq!(attempts(&merged), [1, 2]);
    // nothing is left to do; other flags, or another input, are other work
    let (code, said) = run(batch(&list, &out, &more));
    assert_eq!((code, attempts(&table(&out))), (Some(0), vec![1, 2]));
    assert!(!said.contains("begins"), "{said}");
    let transforms = list.join("a/transforms.json");
    let text = fs::read_to_string(&transforms).expect("a scene");
    fs::write(&transforms, format!("{text}\n")).expect("written");
    let (code, said) = run(batch(&list, &out, &more));
    assert_eq!(
        (code, attempts(&table(&out))),
        (Some(0), vec![2, 2]),
        "{said}"
    );
    let (code, said) = run(batch(&list, &out, &["--seed", "7", "--index", "1"]));
    assert_eq!(
        (code, attempts(&table(&out))),
        (Some(0), vec![2, 3]),
        "{said}"
    );
}

#[test]
fn a_bad_scene_does_not_stop_the_others_and_names_are_distinct() {
    let dir = tempfile::tempdir().expect("temp");
    scenes(dir.path(), &["a", "x/a", "broken", "y/a-2"]);
    let at = |path: &str| dir.path().join("scenes").join(path);
    fs::write(at("broken/transforms.json"), b"{").expect("damaged");
    let lines = "scenes/missing\nscenes/a # the first\n\nscenes/broken\n\
                 \"scenes/x/a\" --albedo-size 32\nscenes/y/a-2/transforms.json\n";
    let (list, out) = (list(dir.path(), lines), dir.path().join("out"));
    let (code, said) = run(batch(&list, &out, &[]));
    assert_eq!(code, Some(1), "{said}");
    let merged = table(&out);
    assert_eq!(
        states(&merged),
        ["failed", "finished", "failed", "finished", "finished"],
        "{merged:#}"
    );
    let names: Vec<&Value> = (0..5).map(|i| &merged["scenes"][i]["name"]).collect();
    assert_eq!(names, ["missing", "a", "broken", "a-3", "a-2"]);
    for (i, word) in [(0, "missing"), (2, "transforms.json")] {
        let message = merged["scenes"][i]["message"].as_str().expect("a message");
        assert!(message.contains(word) && said.contains(message), "{said}");
    }
    // flags of a line are those of its scene alone
    let side = |name: &str| {
        let text = fs::read(out.join(name).join("manifest.json")).expect("a manifest");
        let manifest: Value = serde_json::from_slice(&text).expect("JSON");
        manifest["options"]["solve"]["albedo-size"].as_u64()
    };
    assert_eq!((side("a"), side("a-3")), (Some(64), Some(32)));
    // mended, it is tried again, and nothing else is
    fs::copy(at("a/transforms.json"), at("broken/transforms.json")).expect("mended");
    let (code, said) = run(batch(&list, &out, &[]));
    assert_eq!(code, Some(1), "{said}");
    assert_eq!(attempts(&table(&out)), [2, 1, 2, 1, 1]);
    assert_eq!(states(&table(&out))[2], "finished");
}

#[test]
fn an_index_does_one_scene() {
    let dir = tempfile::tempdir().expect("temp");
    scenes(dir.path(), &["a", "b", "c"]);
    let lines = "scenes/a\nscenes/b\nscenes/none\n";
    let (list, out) = (list(dir.path(), lines), dir.path().join("out"));
    let with = |name: &str, value: &str, more: &[&str]| {
        let mut command = batch(&list, &out, more);
        command.env(name, value);
        run(command)
    };
    assert_eq!(run(batch(&list, &out, &["--index", "1"])).0, Some(0));
    assert_eq!(states(&table(&out)), ["waiting", "finished", "waiting"]);
    assert_eq!(with("SLURM_ARRAY_TASK_ID", "2", &[]).0, Some(1));
    assert_eq!(states(&table(&out)), ["waiting", "finished", "failed"]);
    // the failure of another is no failure of this one
    assert_eq!(with("AWS_BATCH_JOB_ARRAY_INDEX", "0", &[]).0, Some(0));
    assert_eq!(states(&table(&out)), ["finished", "finished", "failed"]);
    // what is typed counts more than what the scheduler says
    let (code, said) = with("SLURM_ARRAY_TASK_ID", "9", &["--index", "all"]);
    assert_eq!(code, Some(1), "{said}");
    assert_eq!(attempts(&table(&out)), [1, 1, 2]);
    for (name, value, said) in [
        ("SLURM_ARRAY_TASK_ID", "3", "SLURM_ARRAY_TASK_ID 3"),
        ("SLURM_ARRAY_TASK_ID", "one", "SLURM_ARRAY_TASK_ID"),
        ("NONE", "", "--index 3"),
    ] {
        let index: &[&str] = if name == "NONE" {
            &["--index", "3"]
        } else {
            &[]
        };
        let (code, text) = with(name, value, index);
        assert!(code == Some(2) && text.contains(said), "{text}");
    }
}

#[test]
fn a_scene_in_other_hands_is_left_alone() {
    let dir = tempfile::tempdir().expect("temp");
    scenes(dir.path(), &["a", "b"]);
    let (list, out) = (dir.path().join("scenes"), dir.path().join("out"));
    fs::create_dir_all(out.join(".batch/a")).expect("folder");
    let lock = fs::File::create(out.join(".batch/a/lock")).expect("a lock");
    lock.lock().expect("ours");
    let (code, said) = run(batch(&list, &out, &[]));
    assert_eq!(code, Some(0), "{said}");
    assert_eq!(states(&table(&out)), ["waiting", "finished"]);
    let (code, said) = run(batch(&list, &out, &["--index", "0"]));
    assert!(
        code == Some(1) && said.contains("another process"),
        "{said}"
    );
    drop(lock);
    assert_eq!(run(batch(&list, &out, &[])).0, Some(0));
    assert_eq!(states(&table(&out)), ["finished", "finished"]);
}

#[test]
fn an_unusable_list_is_2_and_says_why() {
    let dir = tempfile::tempdir().expect("temp");
    let at = |name: &str| dir.path().join(name);
    let file = |name: &str, text: &[u8]| fs::write(at(name), text).expect("written");
    let fifo = Command::new("mkfifo").arg(at("fifo")).status();
    assert!(fifo.expect("mkfifo").success());
    file("empty", b"");
    file("comments", b"# none\n");
    file("binary", b"\xff\xfe\x00");
    file("misspelt", b"a\nb --albedo-sise 3\n");
    file("range", b"a --albedo-size 99999999\n");
    file("threads", b"a --threads 3\n");
    file("help", b"a --help\n");
    file("out-flag", b"a -o there\n");
    fs::create_dir(at("folder")).expect("folder");
    for (name, said) in [
        ("missing", "no such file"),
        ("empty", "names no scene"),
        ("comments", "names no scene"),
        ("folder", "names no scene"),
        ("binary", "UTF-8"),
        ("fifo", "pipe"),
        ("misspelt", "line 2"),
        ("range", "line 1"),
        ("threads", "--threads concerns the whole process"),
        ("help", "line 1"),
        ("out-flag", "line 1"),
    ] {
        let out = at("out");
        let (code, text) = run(batch(&at(name), &out, &[]));
        assert!(code == Some(2) && text.contains(said), "{name}: {text}");
        assert!(!out.exists(), "{name}: nothing is left behind");
    }
    // the list's own folder, a scene, a file
    file("good", b"scene\n");
    copied(room(), &at("scene"));
    for out in [dir.path().to_path_buf(), at("scene"), at("good")] {
        let (code, text) = run(batch(&at("good"), &out, &[]));
        assert_eq!(code, Some(2), "{}: {text}", out.display());
    }
    file("json", b"scene/transforms.json\n");
    let (code, text) = run(batch(&at("json"), &at("scene"), &[]));
    assert!(code == Some(2) && !at("scene/.batch").exists(), "{text}");
    let (code, text) = run(batch(room(), &at("out"), &[]));
    assert!(code == Some(2) && text.contains("itself a scene"), "{text}");
}

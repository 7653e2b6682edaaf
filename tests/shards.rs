//! `unbake solve --shard` and `merge`: several processes give the files of one, whoever is killed.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::OnceLock;
use std::time::{Duration, Instant};

/// Small, but with several blocks in the long stages.
const SIZE: &str = "--quality draft --albedo-size 128 --roughness-size 128 --irradiance-size 128 \
                    --irradiance-rays 64 --emitter-samples 16 --threads 1";

fn unbake(arguments: &str) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_unbake"));
    command
        .args(arguments.split_whitespace())
        .stdin(Stdio::null());
    command
}

fn run(mut command: Command) -> (Option<i32>, String) {
    let out = command.output().expect("the program starts");
    let said = [out.stdout, out.stderr].concat();
    (
        out.status.code(),
        String::from_utf8_lossy(&said).into_owned(),
    )
}

fn work(name: &str) -> PathBuf {
    let folder = PathBuf::from(env!("CARGO_TARGET_TMPDIR")).join(name);
    let _ = fs::remove_dir_all(&folder);
    fs::create_dir_all(&folder).expect("folder");
    folder
}

/// A room and what one process makes of it, once.
fn room() -> &'static (PathBuf, PathBuf) {
    static ROOM: OnceLock<(PathBuf, PathBuf)> = OnceLock::new();
    ROOM.get_or_init(|| {
        let folder = work("shards-room");
        let (scene, one) = (folder.join("scene"), folder.join("one"));
        let mut synth =
            unbake("synth --rooms 1 --views 3 --test-views 1 --width 64 --spp 1 --texture 64 -o");
        synth.arg(&scene);
        assert_eq!(run(synth).0, Some(0));
        let mut solve = unbake("solve -o");
        solve.arg(&one).arg(&scene).args(SIZE.split_whitespace());
        let (code, said) = run(solve);
        assert_eq!(code, Some(0), "{said}");
        (scene, one)
    })
}

fn shard(out: &Path, number: &str) -> Command {
    let mut command = unbake("solve -o");
    command.arg(out).arg(&room().0);
    command.args(SIZE.split_whitespace());
    command.args(["--shard", number]);
    command
}

fn merge(out: &Path, more: &str) -> (Option<i32>, String) {
    let mut command = unbake("merge");
    command.arg(out).args(more.split_whitespace());
    run(command)
}

fn start(mut command: Command) -> Child {
    command
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn()
        .expect("starts")
}

/// Every file but those that hold times.
fn assert_same(out: &Path) {
    let timed = ["manifest.json", "report.json", "report.html"];
    let names = |folder: &Path| -> Vec<String> {
        let mut names: Vec<String> = fs::read_dir(folder)
            .expect("lists")
            .map(|e| e.expect("entry").file_name().to_string_lossy().into_owned())
            .collect();
        names.sort();
        names
    };
    let one = &room().1;
    assert_eq!(names(out), names(one));
    for name in names(one).iter().filter(|n| !timed.contains(&n.as_str())) {
        let (a, b) = (fs::read(one.join(name)), fs::read(out.join(name)));
        assert!(a.expect("there") == b.expect("there"), "{name} differs");
    }
    let blocks = out.with_extension("shards");
    assert!(!blocks.exists(), "{} is left", blocks.display());
}

/// Result files of blocks so far.
fn blocks(out: &Path) -> Vec<PathBuf> {
    let mut found = Vec::new();
    let mut folders = vec![out.with_extension("shards")];
    while let Some(folder) = folders.pop() {
        for entry in fs::read_dir(folder).into_iter().flatten().flatten() {
            let path = entry.path();
            match path.is_dir() {
                true => folders.push(path),
                false if path.extension().is_some_and(|e| e == "block") => found.push(path),
                false => {}
            }
        }
    }
    found.sort();
    found
}

fn wait_for_blocks(out: &Path, count: usize) {
    let begin = Instant::now();
    while blocks(out).len() < count {
        assert!(begin.elapsed() < Duration::from_secs(120), "no blocks");
        std::thread::sleep(Duration::from_millis(2));
    }
}

#[test]
fn processes_at_the_same_time_and_one_after_another_give_the_bits_of_one() {
    let folder = work("shards-many");
    for count in [1, 2, 3, 5] {
        let out = folder.join(format!("{count}"));
        let children: Vec<Child> = (1..=count)
            .map(|i| start(shard(&out, &format!("{i}/{count}"))))
            .collect();
        for mut child in children {
            assert!(child.wait().expect("ends").success());
        }
        assert!(!out.exists(), "shards write no result");
        assert!(blocks(&out).len() > 8, "{count}: {:?}", blocks(&out));
        let (code, said) = merge(&out, "");
        assert_eq!(code, Some(0), "{said}");
        assert_same(&out);
    }
    let out = folder.join("after");
    for i in ["2/2", "1/2"] {
        let (code, said) = run(shard(&out, i));
        assert_eq!(code, Some(0), "{said}");
        assert_eq!(
            said.contains("computed 0 blocks here"),
            i == "1/2",
            "{said}"
        );
    }
    assert_eq!(merge(&out, "").0, Some(0));
    assert_same(&out);
}

#[test]
fn a_killed_shard_costs_its_blocks_only_and_damaged_blocks_are_made_anew() {
    let out = work("shards-killed").join("out");
    let mut killed = start(shard(&out, "1/3"));
    let mut other = start(shard(&out, "2/3"));
    wait_for_blocks(&out, 3);
    killed.kill().expect("runs");
    killed.wait().expect("ended");
    assert!(other.wait().expect("ends").success());
    let some = blocks(&out);
    fs::write(&some[0], b"damaged").expect("writes");
    fs::remove_file(&some[1]).expect("there");
    let (code, said) = merge(&out, "");
    assert_eq!(code, Some(0), "{said}");
    assert!(said.contains("is damaged"), "{said}");
    assert!(said.contains("2 blocks were missing or damaged"), "{said}");
    assert_same(&out);
}

#[test]
fn unfinished_runs_are_completed_on_demand_only() {
    let out = work("shards-unfinished").join("out");
    let (code, said) = merge(&out, "");
    assert!(
        code == Some(2) && said.contains("no blocks to merge"),
        "{said}"
    );
    let mut only = start(shard(&out, "1/2"));
    wait_for_blocks(&out, 3);
    only.kill().expect("runs");
    only.wait().expect("ended");
    let (code, said) = merge(&out, "");
    assert!(
        code == Some(2) && said.contains("no shard has come to its end"),
        "{said}"
    );
    assert!(
        said.contains("blocks") && said.contains("--complete") && !out.exists(),
        "{said}"
    );
    // other options under the same name
    let mut others = shard(&out, "2/2");
    others.args(["--seed", "5"]);
    let (code, said) = run(others);
    assert!(code == Some(2) && said.contains("another run"), "{said}");
    let (code, said) = merge(&out, "--complete");
    assert_eq!(code, Some(0), "{said}");
    assert_same(&out);
}

#[test]
fn what_cannot_be_shared_is_refused() {
    let out = work("shards-refused").join("out");
    for number in ["0/2", "3/2", "x"] {
        let (code, said) = run(shard(&out, number));
        assert!(
            code == Some(2) && said.contains("I from 1 to N"),
            "{number}: {said}"
        );
    }
    let mut timed = shard(&out, "1/2");
    timed.args(["--budget", "60"]);
    let (code, said) = run(timed);
    assert!(code == Some(2) && said.contains("--budget"), "{said}");
    fs::write(&out, b"file").expect("writes");
    let (code, said) = run(shard(&out, "1/2"));
    assert!(code == Some(2) && said.contains("is a file"), "{said}");
}

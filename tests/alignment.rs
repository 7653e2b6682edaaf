//! `unbake check` on small scenes whose photographs and mesh do not fit.

use serde_json::Value;
use std::path::{Path, PathBuf};
use std::process::Command;

/// The folder of shared scenes and cases; `None`, with a word about it, where there is none.
fn shared(what: &str) -> Option<PathBuf> {
    let beside = Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared");
    let root = std::env::var_os("UNBAKE_SHARED").map_or(beside, PathBuf::from);
    let path = root.join(what);
    if !path.exists() {
        eprintln!(
            "skipped: {} is not here (UNBAKE_SHARED names its folder)",
            path.display()
        );
        return None;
    }
    Some(path)
}

fn check(scene: &Path, more: &[&str]) -> (Option<i32>, Value) {
    let out = Command::new(env!("CARGO_BIN_EXE_unbake"))
        .args(["check", "--json", "--quiet"])
        .args(more)
        .arg(scene)
        .output()
        .expect("unbake runs");
    let json = serde_json::from_slice(&out.stdout).expect("JSON on stdout");
    (out.status.code(), json)
}

#[test]
fn cases_of_misalignment_are_refused_and_can_be_corrected() {
    for (case, expected) in [
        ("fc26-mirrored-panoramas", "mirrored"),
        ("fc29-mesh-in-millimetres", "mesh in millimetres"),
        ("fc30-applied-transform", "z up"),
        ("fc32-zup-poses-yup-glb", "the mesh is y up"),
    ] {
        let Some(scene) = shared(&format!("cases/{case}")) else {
            return;
        };
        let (code, json) = check(&scene, &[]);
        assert_eq!(code, Some(2), "{case}: {json:#}");
        assert_eq!(
            json["alignment"]["verdict"], "misaligned",
            "{case}: {json:#}"
        );
        let winner = json["alignment"]["winner"].as_str().unwrap_or_default();
        assert!(winner.contains(expected), "{case}: {winner}");
        let (code, json) = check(&scene, &["--fix-alignment"]);
        assert_eq!(code, Some(0), "{case}: {json:#}");
        assert_eq!(json["summary"]["hole_share"], 0.0, "{case}: {json:#}");
        assert_eq!(
            json["summary"]["unseen_area_share"], 0.0,
            "{case}: {json:#}"
        );
    }
}

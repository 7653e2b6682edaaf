//! `unbake check` on small scenes whose photographs and mesh do not fit.

mod shared;

use serde_json::Value;
use shared::shared;
use std::path::Path;
use std::process::Command;

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
    ] {
        let Some(scene) = shared(format!("cases/{case}")) else {
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

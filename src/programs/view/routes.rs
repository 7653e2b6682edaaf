//! The paths of the page: a fixed list, matched exactly. No path is ever turned into a file name.

use super::content::{Content, Layer};
use super::encode::CAPS;
use super::http::{Body, Request, Response};
use super::live_light;
use crate::render::live::LightEdit;
use glam::{Vec2, Vec3};
use std::sync::Arc;

const HTML: &str = "text/html; charset=utf-8";
const CSS: &str = "text/css; charset=utf-8";
const SCRIPT: &str = "text/javascript; charset=utf-8";
const BLOCK: &str = "application/octet-stream";

/// Files of the page.
const ASSETS: [(&str, &str, &[u8]); 16] = [
    ("/", HTML, include_bytes!("assets/index.html")),
    ("/assets/style.css", CSS, include_bytes!("assets/style.css")),
    ("/assets/main.js", SCRIPT, include_bytes!("assets/main.js")),
    (
        "/assets/camera.js",
        SCRIPT,
        include_bytes!("assets/camera.js"),
    ),
    (
        "/assets/controls.js",
        SCRIPT,
        include_bytes!("assets/controls.js"),
    ),
    (
        "/assets/edits.js",
        SCRIPT,
        include_bytes!("assets/edits.js"),
    ),
    ("/assets/gl.js", SCRIPT, include_bytes!("assets/gl.js")),
    (
        "/assets/layers.js",
        SCRIPT,
        include_bytes!("assets/layers.js"),
    ),
    ("/assets/live.js", SCRIPT, include_bytes!("assets/live.js")),
    ("/assets/load.js", SCRIPT, include_bytes!("assets/load.js")),
    (
        "/assets/panel.js",
        SCRIPT,
        include_bytes!("assets/panel.js"),
    ),
    (
        "/assets/readout.js",
        SCRIPT,
        include_bytes!("assets/readout.js"),
    ),
    (
        "/assets/refinement.js",
        SCRIPT,
        include_bytes!("assets/refinement.js"),
    ),
    (
        "/assets/renderer.js",
        SCRIPT,
        include_bytes!("assets/renderer.js"),
    ),
    (
        "/assets/shaders.js",
        SCRIPT,
        include_bytes!("assets/shaders.js"),
    ),
    (
        "/assets/tracing.js",
        SCRIPT,
        include_bytes!("assets/tracing.js"),
    ),
];

/// Answers a request.
#[must_use]
pub fn answer(content: &Content, request: &Request) -> Response {
    if let Some((_, media_type, bytes)) = ASSETS.iter().find(|a| a.0 == request.path) {
        return Response {
            status: 200,
            media_type,
            body: Body::Embedded(bytes),
        };
    }
    let block = |bytes: Arc<Vec<u8>>| Response {
        status: 200,
        media_type: BLOCK,
        body: Body::Gzip(bytes),
    };
    let unknown = || Response::text(404, "no such page");
    match request.path.as_str() {
        "/api/scene.json" => Response::json(&content.description()),
        "/api/inspect.json" => inspect(content, request),
        "/api/light.json" => Response::json(&content.light().description()),
        "/data/light.bin" => light(content, request),
        "/data/mesh.bin" => block(content.mesh()),
        "/data/environment.bin" => block(Arc::new(content.environment())),
        "/data/rays.bin" => block(content.ray_tree()),
        "/data/response.bin" => block(content.response()),
        "/data/probes.bin" => match edit(request) {
            None => malformed_edit(),
            Some(edit) if edit.changes_nothing() => block(content.panoramas()),
            Some(edit) => block(Arc::new(content.relit_panoramas(&edit))),
        },
        path => match numbered(path) {
            Some((name, number)) => match Layer::ALL.iter().find(|l| l.0 == name) {
                Some((_, layer)) => block(content.texture(*layer, number)),
                None => match name.strip_prefix("photo-").and_then(digits) {
                    Some(camera) => match content.photograph(camera, number) {
                        Ok(Some(bytes)) => block(bytes),
                        Ok(None) => unknown(),
                        Err(e) => Response::text(500, &e.to_string()),
                    },
                    None => unknown(),
                },
            },
            None => unknown(),
        },
    }
}

/// `/data/NAME-CAP.bin` as name and cap, the cap being one of [`CAPS`].
fn numbered(path: &str) -> Option<(&str, usize)> {
    let (name, cap) = path
        .strip_prefix("/data/")?
        .strip_suffix(".bin")?
        .rsplit_once('-')?;
    let cap = digits(cap).filter(|c| CAPS.contains(c))?;
    Some((name, cap))
}

/// A plain number without sign or leading zero.
fn digits(text: &str) -> Option<usize> {
    let plain = text.len() <= 9
        && text.bytes().all(|b| b.is_ascii_digit())
        && (text == "0" || !text.starts_with('0'));
    text.parse().ok().filter(|_| plain)
}

/// The changed light that a request asks for; `None` if it is malformed.
fn edit(request: &Request) -> Option<LightEdit> {
    live_light::parse_edit(request.text("lights"), request.text("classes"))
}

fn malformed_edit() -> Response {
    Response::text(
        400,
        "expected lights=R_G_B-R_G_B… and classes=ID_R_G_B-…: factors that are finite and not negative",
    )
}

fn light(content: &Content, request: &Request) -> Response {
    edit(request).map_or_else(malformed_edit, |edit| Response {
        status: 200,
        media_type: BLOCK,
        body: Body::Plain(content.light().answer(&edit)),
    })
}

fn inspect(content: &Content, request: &Request) -> Response {
    let (Some(u), Some(v)) = (request.number("u"), request.number("v")) else {
        return Response::text(
            400,
            "expected u and v, the atlas coordinate, as finite numbers",
        );
    };
    let point = match (
        request.number("x"),
        request.number("y"),
        request.number("z"),
    ) {
        (Some(x), Some(y), Some(z)) => Some(Vec3::new(x, y, z)),
        _ => None,
    };
    Response::json(&content.inspect(Vec2::new(u, v), point))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::solution::tests::small_solution;

    fn get(content: &Content, target: &str) -> Response {
        let (path, query) = target.split_once('?').unwrap_or((target, ""));
        answer(
            content,
            &Request {
                path: path.into(),
                query: query.into(),
                accepts_gzip: true,
                keep_alive: false,
            },
        )
    }

    fn content() -> Content {
        Content::new(small_solution(), None, None).expect("prepares")
    }

    #[test]
    fn every_path_of_the_page_answers() {
        let content = content();
        for (path, media_type, _) in ASSETS {
            let response = get(&content, path);
            assert_eq!(
                (response.status, response.media_type),
                (200, media_type),
                "{path}"
            );
        }
        for path in [
            "/api/scene.json",
            "/api/light.json",
            "/api/inspect.json?u=0.5&v=0.5",
            "/data/mesh.bin",
            "/data/light.bin",
            "/data/probes.bin?lights=0_0_1",
            "/data/light.bin?lights=1_0.5_0&classes=3_1_1_0.25-7_0_0_0",
        ] {
            assert_eq!(get(&content, path).status, 200, "{path}");
        }
        for (layer, _) in Layer::ALL {
            assert_eq!(
                get(&content, &format!("/data/{layer}-1024.bin")).status,
                200,
                "{layer}"
            );
        }
        for name in ["environment", "rays", "response"] {
            let path = format!("/data/{name}.bin");
            assert_eq!(get(&content, &path).status, 200, "{path}");
        }
        assert_eq!(get(&content, "/data/probes.bin").status, 200);
    }

    #[test]
    fn anything_else_is_unknown() {
        let content = content();
        for path in [
            "",
            "//",
            "/index.html",
            "/assets/",
            "/assets/../mod.rs",
            "/assets/main.js/",
            "/etc/passwd",
            "/data/albedo-1025.bin",
            "/data/albedo-01024.bin",
            "/data/albedo-99999999999999999999.bin",
            "/data/albedo-+1024.bin",
            "/data/-1024.bin",
            "/data/photo-0-1024.bin",
            "/data/photo--1-1024.bin",
            "/data/scene.glb",
            "/api/scene.json/",
        ] {
            assert_eq!(get(&content, path).status, 404, "{path}");
        }
        for query in ["", "?u=1", "?u=NaN&v=0", "?u=1e99&v=0"] {
            assert_eq!(
                get(&content, &format!("/api/inspect.json{query}")).status,
                400,
                "{query}"
            );
        }
        assert_eq!(
            get(&content, "/api/inspect.json?u=-5&v=1e30&x=1e30&y=0&z=0").status,
            200
        );
    }

    #[test]
    fn changed_light_is_checked() {
        let content = content();
        for query in [
            "lights=1_1",
            "lights=1_1_1_1",
            "lights=NaN_1_1",
            "lights=1_-1_1",
            "lights=1e30_1_1",
            "lights=1_1_1-",
            "classes=1_1_1",
            "classes=70000_1_1_1",
            "classes=1_1_1_x",
        ] {
            let target = format!("/data/light.bin?{query}");
            assert_eq!(get(&content, &target).status, 400, "{query}");
        }
    }

    #[test]
    fn the_page_asks_for_known_files_only() {
        let html = include_str!("assets/index.html");
        for part in html.split("\"/").skip(1) {
            let path = format!("/{}", part.split('"').next().unwrap_or_default());
            assert!(ASSETS.iter().any(|a| a.0 == path), "{path}");
        }
        assert!(
            !html.contains("http://") && !html.contains("https://"),
            "nothing is fetched from elsewhere"
        );
        for (path, _, bytes) in ASSETS.iter().filter(|a| a.1 == SCRIPT) {
            let text = std::str::from_utf8(bytes).expect("text");
            assert!(text.lines().count() < 500, "{path} is too long");
            for import in text
                .lines()
                .filter_map(|l| l.trim().strip_prefix("import "))
            {
                let from = import.split('\'').nth(1).expect("quoted with '");
                let target = format!("/assets/{}", from.trim_start_matches("./"));
                assert!(
                    ASSETS.iter().any(|a| a.0 == target),
                    "{path} imports {from}"
                );
            }
        }
    }
}

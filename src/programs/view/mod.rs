//! `unbake view`: a local page on which a reconstruction can be walked through, read and tried out.
//!
//! The program serves its own small WebGL 2 viewer (under `assets`, part of the binary) and the
//! solution's textures to this machine's browser. Everything the page shows of the light is the
//! reconstruction itself; where it changes something, it says how it approximates the answer.

mod content;
mod encode;
mod http;
mod inspect;
mod lamps;
mod live_light;
mod photos;
mod probes;
mod ray_tree;
mod response;
mod routes;
mod server;

pub use content::Content;
pub use http::parse as parse_request;
pub use server::{Server, Stopper};

use crate::error::Result;
use std::net::{IpAddr, Ipv4Addr};
use std::sync::Arc;

/// The port tried first if none is given.
const PORT: u16 = 8321;

/// What `unbake view` can be told.
#[derive(clap::Args, Clone, Debug, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(default, deny_unknown_fields, rename_all = "kebab-case")]
#[command(next_help_heading = "Page")]
pub struct ViewOptions {
    /// Port to listen on [default: 8321, or the next free one]; 0 takes any free one.
    #[arg(long, value_name = "PORT")]
    pub port: Option<u16>,
    /// Address to listen on; any other than the default lets other machines read the scene.
    #[arg(long, value_name = "ADDRESS", default_value_t = Self::default().bind)]
    pub bind: IpAddr,
    /// Only print the address, do not open a browser.
    #[arg(long)]
    pub no_open: bool,
}

impl Default for ViewOptions {
    fn default() -> Self {
        Self {
            port: None,
            bind: IpAddr::V4(Ipv4Addr::LOCALHOST),
            no_open: false,
        }
    }
}

/// Binds a server that shows `content`; [`Server::run`] serves it.
///
/// # Errors
/// If the address cannot be had.
pub fn server(content: Content, options: &ViewOptions) -> Result<Server> {
    let content = Arc::new(content);
    Server::bind(
        options.bind,
        options.port,
        PORT,
        Arc::new(move |request| routes::answer(&content, request)),
    )
}

/// Opens a page in the desktop's browser; without a desktop nothing happens.
pub fn open_in_browser(url: &str) {
    let desktop = ["DISPLAY", "WAYLAND_DISPLAY"]
        .iter()
        .any(|v| std::env::var_os(v).is_some_and(|d| !d.is_empty()));
    if desktop {
        let null = std::process::Stdio::null;
        // the address is printed as well: a missing browser is no failure
        let _ = std::process::Command::new("xdg-open")
            .arg(url)
            .stdin(null())
            .stdout(null())
            .stderr(null())
            .spawn();
    }
}

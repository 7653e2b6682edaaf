//! Finds Embree and OpenImageIO, makes Embree's bindings from the system's own headers and compiles
//! the C++ shims of `ffi/`.
//!
//! Bindings are never shipped ready-made: Embree 4.3 grew `RTCRayHit`, and a program built with
//! older structures has its stack overwritten by a newer library.

use std::env;
use std::path::{Path, PathBuf};

const PACKAGES: &str = "apt-get install --no-install-recommends libembree-dev libopenimageio-dev libjpeg-dev libclang-dev pkg-config g++";

/// An Embree installation: headers, library folder and version.
struct Embree {
    include: PathBuf,
    library: PathBuf,
    major: u32,
    version: String,
}

fn main() {
    println!("cargo:rerun-if-changed=build.rs");
    println!("cargo:rerun-if-changed=ffi");
    println!("cargo:rerun-if-env-changed=EMBREE_DIR");
    if let Err(message) = run() {
        for line in message.lines() {
            println!("cargo:warning={line}");
        }
        eprintln!("\nerror: {message}\n");
        std::process::exit(1);
    }
}

fn run() -> Result<(), String> {
    let out =
        PathBuf::from(env::var_os("OUT_DIR").ok_or("OUT_DIR is not set: run this through cargo")?);
    let embree = find_embree()?;
    println!("cargo:rustc-env=UNBAKE_EMBREE_HEADERS={}", embree.version);
    println!(
        "cargo:rustc-link-search=native={}",
        embree.library.display()
    );
    println!("cargo:rustc-link-lib=dylib=embree{}", embree.major);
    if !embree.library.starts_with("/usr/lib") {
        println!(
            "cargo:rustc-link-arg=-Wl,-rpath,{}",
            embree.library.display()
        );
    }
    bind_embree(&embree, &out)?;
    build_image_shim(&out)?;
    cc::Build::new()
        .cpp(true)
        .std("c++17")
        .opt_level(3)
        .include(&embree.include)
        .define("UNBAKE_EMBREE_MAJOR", embree.major.to_string().as_str())
        .file("ffi/trace_shim.cpp")
        .try_compile("unbake_trace")
        .map_err(|e| {
            format!("the C++ shim of Embree did not compile: {e}\nIs g++ installed? {PACKAGES}")
        })
}

/// Looks for Embree 4 (4.3 or newer), then 3.13, in `$EMBREE_DIR`, `/usr/local` and `/usr`.
fn find_embree() -> Result<Embree, String> {
    let mut prefixes: Vec<PathBuf> = vec!["/usr/local".into(), "/usr".into()];
    if let Some(dir) = env::var_os("EMBREE_DIR").filter(|d| !d.is_empty()) {
        prefixes = vec![dir.into()];
    }
    let mut refused = Vec::new();
    for prefix in &prefixes {
        for major in [4, 3] {
            let config = prefix.join(format!("include/embree{major}/rtcore_config.h"));
            let Ok(text) = std::fs::read_to_string(&config) else {
                continue;
            };
            println!("cargo:rerun-if-changed={}", config.display());
            let number = |name: &str| define(&text, name).and_then(|v| v.parse::<u32>().ok());
            let parts = (
                number("RTC_VERSION_MAJOR"),
                number("RTC_VERSION_MINOR"),
                number("RTC_VERSION_PATCH"),
            );
            let (Some(found), Some(minor), Some(patch)) = parts else {
                refused.push(format!("{} names no version", config.display()));
                continue;
            };
            let version = format!("{found}.{minor}.{patch}");
            if found != major || (major == 4 && minor < 3) || (major == 3 && minor < 13) {
                refused.push(format!(
                    "{} is Embree {version}; 4.3 or newer, or 3.13, is needed",
                    config.display()
                ));
                continue;
            }
            match library_folder(prefix, major) {
                Some(library) => {
                    return Ok(Embree {
                        include: prefix.join("include"),
                        library,
                        major,
                        version,
                    });
                }
                None => refused.push(format!(
                    "headers of Embree {version} in {} but no libembree{major}.so",
                    prefix.display()
                )),
            }
        }
    }
    let places = prefixes
        .iter()
        .map(|p| p.display().to_string())
        .collect::<Vec<_>>()
        .join(", ");
    let detail = refused
        .iter()
        .map(|r| format!("\n  {r}"))
        .collect::<String>();
    Err(format!(
        "no usable Embree (4.3 or newer, or 3.13) found in {places}{detail}\nInstall it: {PACKAGES}\n\
         or set EMBREE_DIR to the folder that holds its include/ and lib/"
    ))
}

/// The value of `#define name value`.
fn define<'a>(text: &'a str, name: &str) -> Option<&'a str> {
    text.lines().find_map(|line| {
        let mut words = line.split_whitespace();
        (words.next()? == "#define" && words.next()? == name).then(|| words.next())?
    })
}

/// The folder below `prefix` that holds `libembree<major>.so`.
fn library_folder(prefix: &Path, major: u32) -> Option<PathBuf> {
    let triplet = format!(
        "{}-linux-gnu",
        env::var("CARGO_CFG_TARGET_ARCH").unwrap_or_else(|_| "x86_64".into())
    );
    let folders = [format!("lib/{triplet}"), "lib".into(), "lib64".into()];
    folders
        .iter()
        .map(|f| prefix.join(f))
        .find(|f| f.join(format!("libembree{major}.so")).exists())
}

/// Bindings of the handful of Embree functions the owners in `src/ffi` call, and of our shim.
fn bind_embree(embree: &Embree, out: &Path) -> Result<(), String> {
    let builder = bindgen::Builder::default()
        .header("ffi/trace_shim.h")
        .clang_arg(format!("-I{}", embree.include.display()))
        .clang_arg(format!("-DUNBAKE_EMBREE_MAJOR={}", embree.major))
        .allowlist_function("unbake_.*")
        .allowlist_function("rtc(New|Release)(Device|Scene|Geometry)")
        .allowlist_function("rtc(GetDeviceProperty|GetDeviceError|SetDeviceErrorFunction)")
        .allowlist_function(
            "rtc(SetSceneBuildQuality|SetSceneFlags|CommitScene|AttachGeometry|CommitGeometry)",
        )
        .allowlist_function("rtc(SetGeometryBuildQuality|SetGeometryMask|SetNewGeometryBuffer)")
        .allowlist_type(
            "RTC(DeviceProperty|Error|BuildQuality|SceneFlags|GeometryType|BufferType|Format)",
        )
        .allowlist_var("RTC_VERSION.*")
        .prepend_enum_name(false)
        .layout_tests(true)
        .generate_comments(false);
    // bindgen panics, rather than fails, when libclang cannot be loaded.
    let bindings = std::panic::catch_unwind(std::panic::AssertUnwindSafe(|| builder.generate()))
        .map_err(|_| {
            format!("libclang could not be loaded (bindgen needs it)\nInstall it: {PACKAGES}")
        })?
        .map_err(|e| {
            format!("Embree's headers could not be read: {e}\nInstall what is missing: {PACKAGES}")
        })?;
    let file = out.join("embree_bindings.rs");
    bindings
        .write_to_file(&file)
        .map_err(|e| format!("{}: {e}", file.display()))
}

/// Compiles the OpenImageIO shim into a shared object of its own, `libunbake_oiio.so` in `out`,
/// which the program embeds.
fn build_image_shim(out: &Path) -> Result<(), String> {
    let oiio = pkg_config::Config::new()
        .atleast_version("2.4")
        .cargo_metadata(false)
        .probe("OpenImageIO")
        .map_err(|e| {
            format!("no usable OpenImageIO (2.4 or newer): {e}\nInstall it: {PACKAGES}")
        })?;
    bind_image_shim(out)?;
    let mut build = cc::Build::new();
    build
        .cpp(true)
        .std("c++17")
        .opt_level(2)
        .pic(true)
        // a shared library would bring this compiler's sanitizer beside rustc's (scripts/fuzz)
        .flag_if_supported("-fno-sanitize=address")
        .cargo_metadata(false)
        .includes(&oiio.include_paths);
    let failed = |e: &dyn std::fmt::Display| {
        format!("the C++ shim of OpenImageIO did not compile: {e}\nInstall it: {PACKAGES}")
    };
    let objects = build
        .file("ffi/oiio_shim.cpp")
        .try_compile_intermediates()
        .map_err(|e| failed(&e))?;
    let mut link = build
        .try_get_compiler()
        .map_err(|e| failed(&e))?
        .to_command();
    link.args(["-shared", "-s", "-Wl,--no-undefined"])
        .args(&objects)
        .arg("-o")
        .arg(out.join("libunbake_oiio.so"));
    for path in &oiio.link_paths {
        link.arg(format!("-L{}", path.display()));
        if !path.starts_with("/usr/lib") {
            link.arg(format!("-Wl,-rpath,{}", path.display()));
        }
    }
    link.args(oiio.libs.iter().map(|l| format!("-l{l}")));
    // what OpenImageIO itself reads JPEG with: it is loaded along with it
    link.arg("-ljpeg");
    let status = link.status().map_err(|e| failed(&e))?;
    if status.success() {
        Ok(())
    } else {
        Err(failed(&format!("the linker ended with {status}")))
    }
}

/// Types of the OpenImageIO shim's functions, looked up by name at run time.
fn bind_image_shim(out: &Path) -> Result<(), String> {
    let bindings = bindgen::Builder::default()
        .header("ffi/oiio_shim.h")
        .allowlist_type("UnbakeImageInfo")
        .allowlist_var("UNBAKE_.*")
        .allowlist_function("unbake_image_.*")
        .dynamic_library_name("ImageShim")
        .dynamic_link_require_all(true)
        .wrap_unsafe_ops(true)
        .generate_comments(false)
        .generate()
        .map_err(|e| format!("ffi/oiio_shim.h could not be read: {e}"))?;
    let file = out.join("oiio_bindings.rs");
    bindings
        .write_to_file(&file)
        .map_err(|e| format!("{}: {e}", file.display()))
}

//! OpenImageIO: opening, reading and writing images through the C++ shim, loaded at the first
//! image.
//!
//! The shim is a shared object embedded in the program (`build.rs`). It is handed to the dynamic
//! loader as an anonymous memory file, so that no temporary folder has to exist or allow execution,
//! and stays loaded until the process ends.

use std::ffi::{CStr, CString, c_char, c_int, c_void};
use std::io::Write;
use std::os::fd::{AsRawFd, FromRawFd};
use std::os::unix::ffi::OsStrExt;
use std::path::Path;
use std::sync::OnceLock;

/// What bindgen made of `ffi/oiio_shim.h`.
#[allow(
    non_camel_case_types,
    non_snake_case,
    non_upper_case_globals,
    dead_code,
    missing_docs,
    clippy::all,
    clippy::undocumented_unsafe_blocks
)]
mod sys {
    include!(concat!(env!("OUT_DIR"), "/oiio_bindings.rs"));
}

/// The compiled shim.
static SHIM: &[u8] = include_bytes!(concat!(env!("OUT_DIR"), "/libunbake_oiio.so"));

unsafe extern "C" {
    fn memfd_create(name: *const c_char, flags: std::ffi::c_uint) -> c_int;
}

/// The loaded shim, or why it could not be loaded.
fn shim() -> Result<&'static sys::ImageShim, String> {
    static LOADED: OnceLock<Result<sys::ImageShim, String>> = OnceLock::new();
    LOADED.get_or_init(load).as_ref().map_err(Clone::clone)
}

fn load() -> Result<sys::ImageShim, String> {
    let failed = |e: &dyn std::fmt::Display| {
        format!(
            "OpenImageIO could not be loaded: {e}\nInstall it (Debian: libopenimageio2.4 or libopenimageio2.5) or rebuild unbake"
        )
    };
    // SAFETY: the name is NUL-terminated; flag 1 is MFD_CLOEXEC.
    let fd = unsafe { memfd_create(c"unbake_oiio".as_ptr(), 1) };
    if fd < 0 {
        return Err(failed(&std::io::Error::last_os_error()));
    }
    // SAFETY: `fd` was just made and nothing else owns it.
    let mut file = unsafe { std::fs::File::from_raw_fd(fd) };
    file.write_all(SHIM).map_err(|e| failed(&e))?;
    // SAFETY: the object was built from ffi/oiio_shim.cpp along with these bindings; its
    // initialisers, and those of the libraries it needs, are ordinary C++ static constructors. The
    // file may be closed once it is mapped.
    let shim = unsafe { sys::ImageShim::new(format!("/proc/self/fd/{}", file.as_raw_fd())) }
        .map_err(|e| failed(&e))?;
    // SAFETY: takes nothing, returns a constant.
    let abi = unsafe { shim.unbake_image_abi() };
    if abi == sys::UNBAKE_IMAGE_ABI as c_int {
        Ok(shim)
    } else {
        Err(failed(&"the embedded shim is of another build"))
    }
}

/// OpenImageIO's run-time version, such as `2.5.18`; loads the library.
///
/// # Errors
/// If the library is not found.
pub fn version() -> Result<String, String> {
    // SAFETY: takes nothing, returns a number.
    let v = unsafe { shim()?.unbake_image_version() };
    Ok(format!("{}.{}.{}", v / 10000, v / 100 % 100, v % 100))
}

/// Room for the library's error text.
struct ErrorText([u8; 1024]);

impl ErrorText {
    fn new() -> Self {
        Self([0; 1024])
    }

    fn as_mut_ptr(&mut self) -> *mut c_char {
        self.0.as_mut_ptr().cast()
    }

    fn text(&self) -> String {
        let text = CStr::from_bytes_until_nul(&self.0)
            .map(|c| c.to_string_lossy().trim().to_string())
            .unwrap_or_default();
        if text.is_empty() {
            "no reason given".into()
        } else {
            text
        }
    }
}

fn c_path(path: &Path) -> Result<CString, String> {
    CString::new(path.as_os_str().as_bytes()).map_err(|_| "the path contains a zero byte".into())
}

/// How samples are stored in a file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Sample {
    /// Unsigned 8-bit.
    U8,
    /// Unsigned 16-bit.
    U16,
    /// IEEE half precision.
    Half,
    /// IEEE single precision.
    Float,
    /// Anything else.
    Other,
}

/// An image opened for reading.
pub struct OpenImage {
    raw: *mut c_void,
    info: sys::UnbakeImageInfo,
    shim: &'static sys::ImageShim,
}

impl OpenImage {
    /// Opens `path` with the reader `format` (`openexr`, `hdr`, `jpeg`), whatever the file is
    /// called; of a file of several parts the one numbered `part`.
    ///
    /// # Errors
    /// In the library's own words: the file is missing, damaged or of another format.
    pub fn open(path: &Path, format: &CStr, part: usize) -> Result<Self, String> {
        let shim = shim()?;
        let name = c_path(path)?;
        // SAFETY: the structure holds only integers, for which all zeros is a value.
        let mut info: sys::UnbakeImageInfo = unsafe { std::mem::zeroed() };
        let mut error = ErrorText::new();
        // SAFETY: all pointers are live for the call, strings are NUL-terminated, the error
        // buffer's size is its own.
        let raw = unsafe {
            shim.unbake_image_open(
                name.as_ptr(),
                format.as_ptr(),
                c_int::try_from(part).unwrap_or(c_int::MAX),
                &raw mut info,
                error.as_mut_ptr(),
                error.0.len(),
            )
        };
        if raw.is_null() {
            Err(error.text())
        } else {
            Ok(Self { raw, info, shim })
        }
    }

    /// Columns, rows and channels as the file states them; not yet judged.
    #[must_use]
    pub fn size(&self) -> (i32, i32, i32) {
        (self.info.width, self.info.height, self.info.channels)
    }

    /// Whether every pixel of the image the file speaks of is stored: data window equal to display
    /// window.
    #[must_use]
    pub fn is_uncropped(&self) -> bool {
        let i = &self.info;
        (i.x, i.y, i.width, i.height) == (i.full_x, i.full_y, i.full_width, i.full_height)
    }

    /// Whether it is a flat, two-dimensional image.
    #[must_use]
    pub fn is_flat(&self) -> bool {
        self.info.depth <= 1 && self.info.deep == 0
    }

    /// EXIF orientation; 1 is the usual: first row on top, first column left.
    #[must_use]
    pub fn orientation(&self) -> i32 {
        self.info.orientation
    }

    /// How samples are stored.
    #[must_use]
    pub fn sample(&self) -> Sample {
        match self.info.sample as u32 {
            sys::UNBAKE_SAMPLE_U8 => Sample::U8,
            sys::UNBAKE_SAMPLE_U16 => Sample::U16,
            sys::UNBAKE_SAMPLE_HALF => Sample::Half,
            sys::UNBAKE_SAMPLE_FLOAT => Sample::Float,
            _ => Sample::Other,
        }
    }

    /// Name of channel `c`; empty if there is no such channel.
    #[must_use]
    pub fn channel_name(&self, c: usize) -> String {
        let c = c_int::try_from(c).unwrap_or(c_int::MAX);
        // SAFETY: the image is open, and the returned string lives as long as it is; it is copied
        // at once.
        unsafe { CStr::from_ptr(self.shim.unbake_image_channel(self.raw, c)) }
            .to_string_lossy()
            .into_owned()
    }

    /// Reads channels `channels` of every pixel into `out[offset..]`, pixels `step` floats apart.
    ///
    /// # Errors
    /// If the file ends early or `out` is too short.
    pub fn read(
        &mut self,
        channels: std::ops::Range<usize>,
        out: &mut [f32],
        offset: usize,
        step: usize,
    ) -> Result<(), String> {
        let (w, h, c) = self.size();
        let (Ok(w), Ok(h), Ok(c)) = (usize::try_from(w), usize::try_from(h), usize::try_from(c))
        else {
            return Err("negative size".into());
        };
        let pixels = w
            .checked_mul(h)
            .filter(|&n| n.checked_mul(step) == Some(out.len()))
            .ok_or("wrong buffer size")?;
        if pixels == 0 || channels.is_empty() || channels.end > c || offset + channels.len() > step
        {
            return Err("wrong channel range".into());
        }
        let mut error = ErrorText::new();
        // SAFETY: the image is open; the last float written is `offset + (pixels − 1)·step +
        // channels.len() − 1`, which the checks above keep below `pixels · step = out.len()`.
        let done = unsafe {
            let first = out.as_mut_ptr().add(offset);
            let (begin, end) = (channels.start as c_int, channels.end as c_int);
            self.shim.unbake_image_read(
                self.raw,
                begin,
                end,
                first,
                step * size_of::<f32>(),
                error.as_mut_ptr(),
                error.0.len(),
            )
        };
        if done == 1 { Ok(()) } else { Err(error.text()) }
    }
}

impl Drop for OpenImage {
    fn drop(&mut self) {
        // SAFETY: the image is owned here and not used afterwards.
        unsafe { self.shim.unbake_image_close(self.raw) };
    }
}

/// Whether the JPEG file at `path` holds all of its picture; the error is libjpeg's remark.
///
/// # Errors
/// Its data are cut short or damaged, or the file is no JPEG that libjpeg reads.
pub fn whole_jpeg(path: &Path) -> Result<(), String> {
    let shim = shim()?;
    let name = c_path(path)?;
    let mut error = ErrorText::new();
    // SAFETY: the name is NUL-terminated, the error buffer's size is its own, and both outlive the
    // call.
    let whole =
        unsafe { shim.unbake_image_whole_jpeg(name.as_ptr(), error.as_mut_ptr(), error.0.len()) };
    if whole == 1 {
        Ok(())
    } else {
        Err(error.text())
    }
}

/// Samples to write: raw bits of half floats, or floats.
#[derive(Clone, Copy)]
pub enum Samples<'a> {
    /// IEEE half precision.
    Half(&'a [half::f16]),
    /// IEEE single precision.
    Float(&'a [f32]),
}

/// Writes an OpenEXR image of `width × height × names.len()` interleaved samples to `path`,
/// ZIP-compressed; `mark`, if not empty, becomes its attribute `unbake:generation`, and three
/// channels are called linear Rec. 709.
///
/// # Errors
/// If the sizes disagree or the file system refuses.
pub fn write(
    path: &Path,
    (width, height): (usize, usize),
    names: &[&CStr],
    samples: Samples,
    mark: &str,
) -> Result<(), String> {
    let (length, kind, data): (usize, _, *const c_void) = match samples {
        Samples::Half(s) => (s.len(), sys::UNBAKE_SAMPLE_HALF, s.as_ptr().cast()),
        Samples::Float(s) => (s.len(), sys::UNBAKE_SAMPLE_FLOAT, s.as_ptr().cast()),
    };
    let expected = width
        .checked_mul(height)
        .and_then(|n| n.checked_mul(names.len()));
    let (Ok(w), Ok(h)) = (c_int::try_from(width), c_int::try_from(height)) else {
        return Err(format!("{width} × {height} pixels: too large for OpenEXR"));
    };
    if length == 0 || expected != Some(length) {
        return Err(format!(
            "{width} × {height} pixels of {} channels need other than {length} samples",
            names.len()
        ));
    }
    let shim = shim()?;
    let name = c_path(path)?;
    let mark = CString::new(mark).map_err(|_| "the mark contains a zero byte")?;
    let names: Vec<*const c_char> = names.iter().map(|n| n.as_ptr()).collect();
    let mut error = ErrorText::new();
    // SAFETY: `data` holds `w · h · names.len()` samples of the stated type, every string is
    // NUL-terminated and all of them outlive the call.
    let done = unsafe {
        shim.unbake_image_write(
            name.as_ptr(),
            w,
            h,
            names.len() as c_int,
            names.as_ptr(),
            kind as c_int,
            data,
            mark.as_ptr(),
            c_int::from(names.len() == 3),
            error.as_mut_ptr(),
            error.0.len(),
        )
    };
    if done == 1 { Ok(()) } else { Err(error.text()) }
}

//! Open Image Denoise: its lightmap filter, for comparison with ours. Loaded at run time where it
//! is found.
//!
//! Nothing of the program needs the library, so neither its headers nor a shim are part of the
//! build: the few functions are declared here by hand, from the C interface of version 2. Once
//! loaded it stays until the process ends, for threads of its own may outlive a device.

use glam::Vec3;
use std::ffi::{CStr, OsString, c_char, c_int, c_void};
use std::mem::ManuallyDrop;
use std::path::Path;

/// Environment variable that names the library.
pub const VARIABLE: &str = "OIDN_LIBRARY";

/// Names under which the system's loader may know the library; the one that promises version 2
/// first.
const NAMES: [&str; 2] = ["libOpenImageDenoise.so.2", "libOpenImageDenoise.so"];

/// The major version that the declarations below are of.
const MAJOR: c_int = 2;

/// `OIDN_DEVICE_TYPE_CPU`.
const DEVICE_CPU: c_int = 1;
/// `OIDN_FORMAT_FLOAT3`.
const FORMAT_FLOAT3: c_int = 3;
/// `OIDN_ERROR_NONE`.
const ERROR_NONE: c_int = 0;

/// Handle of a device or a filter.
type Handle = *mut c_void;

const _: () = assert!(size_of::<Vec3>() == 3 * size_of::<f32>());

/// Declares the functions that are used, and finds them by name in a library.
macro_rules! functions {
    ($($field:ident = $symbol:literal: fn($($argument:ty),*) $(-> $result:ty)?;)*) => {
        /// The library's functions.
        #[derive(Clone, Copy)]
        struct Functions {
            $($field: unsafe extern "C" fn($($argument),*) $(-> $result)?,)*
        }

        impl Functions {
            fn of(library: &libloading::Library) -> Result<Self, libloading::Error> {
                // SAFETY: the types are those that the library's C header gives these names;
                // enumerations without negative values are passed like `int`, `bool` is one byte in
                // both languages. The library is never unloaded.
                unsafe { Ok(Self { $($field: *library.get(concat!($symbol, "\0").as_bytes())?,)* }) }
            }
        }
    };
}

functions! {
    new_device = "oidnNewDevice": fn(c_int) -> Handle;
    set_device_int = "oidnSetDeviceInt": fn(Handle, *const c_char, c_int);
    set_device_bool = "oidnSetDeviceBool": fn(Handle, *const c_char, bool);
    device_int = "oidnGetDeviceInt": fn(Handle, *const c_char) -> c_int;
    commit_device = "oidnCommitDevice": fn(Handle);
    device_error = "oidnGetDeviceError": fn(Handle, *mut *const c_char) -> c_int;
    release_device = "oidnReleaseDevice": fn(Handle);
    new_filter = "oidnNewFilter": fn(Handle, *const c_char) -> Handle;
    set_image = "oidnSetSharedFilterImage": fn(Handle, *const c_char, *mut c_void, c_int, usize, usize, usize, usize, usize);
    commit_filter = "oidnCommitFilter": fn(Handle);
    execute_filter = "oidnExecuteFilter": fn(Handle);
    release_filter = "oidnReleaseFilter": fn(Handle);
}

/// Open Image Denoise, ready to filter on the processor.
pub struct Denoiser {
    functions: Functions,
    device: Handle,
    version: c_int,
}

impl Denoiser {
    /// Loads the library and starts it with `threads` threads (at least 1; the library takes no
    /// more than the machine has).
    ///
    /// The library is `file` if one is given, else the one that [`VARIABLE`] names, else whatever
    /// the system's loader finds.
    ///
    /// # Errors
    /// No library there, one of another major version, or one that does not run on this machine.
    /// The message names the file and the way out.
    pub fn open(file: Option<&Path>, threads: usize) -> Result<Self, String> {
        let variable = std::env::var_os(VARIABLE).filter(|v| !v.is_empty());
        let named = file.map(|f| f.as_os_str().to_owned()).or(variable);
        let candidates = named.map_or_else(|| NAMES.map(OsString::from).to_vec(), |n| vec![n]);
        let mut reasons = Vec::with_capacity(candidates.len());
        for name in &candidates {
            match Self::load(Path::new(name), threads) {
                Ok(denoiser) => return Ok(denoiser),
                Err(reason) => reasons.push(format!("{}: {reason}", name.display())),
            }
        }
        Err(format!(
            "Open Image Denoise cannot be used: {}\nName a library of version {MAJOR} by --oidn FILE or by the environment variable \
             {VARIABLE}; `scripts/compare oidn SCENE` fetches one",
            reasons.join("; ")
        ))
    }

    fn load(path: &Path, threads: usize) -> Result<Self, String> {
        // the loader's own message begins with the name of the file, which the caller states
        let failed = |e: libloading::Error| {
            let text = e.to_string();
            text.strip_prefix(&format!("{}: ", path.display()))
                .unwrap_or(&text)
                .to_owned()
        };
        // SAFETY: whoever names a file vouches for it as for a program; the library's initialisers
        // are ordinary C++ static constructors.
        let library = unsafe { libloading::Library::new(path) }.map_err(failed)?;
        // its threads may run until the process ends
        let library = ManuallyDrop::new(library);
        let functions = Functions::of(&library).map_err(failed)?;
        // SAFETY: takes a constant of the interface.
        let device = unsafe { (functions.new_device)(DEVICE_CPU) };
        let mut denoiser = Self {
            functions,
            device,
            version: 0,
        };
        if device.is_null() {
            // a null device stands for the creation of a device on this thread
            denoiser.check()?;
            return Err("it has no device for this processor".into());
        }
        // SAFETY: the device is live, the names are NUL-terminated and among those that the library
        // knows.
        unsafe {
            denoiser.version = (functions.device_int)(device, c"version".as_ptr());
            (functions.set_device_int)(
                device,
                c"numThreads".as_ptr(),
                c_int::try_from(threads.max(1)).unwrap_or(c_int::MAX),
            );
            // pinned threads would compete with ours for single cores
            (functions.set_device_bool)(device, c"setAffinity".as_ptr(), false);
        }
        if denoiser.version / 10_000 != MAJOR {
            return Err(format!(
                "it is version {}, version {MAJOR} is needed",
                denoiser.version()
            ));
        }
        // SAFETY: the device is live and not committed yet.
        unsafe { (functions.commit_device)(device) };
        denoiser.check()?;
        Ok(denoiser)
    }

    /// The library's version, such as `2.3.1`.
    #[must_use]
    pub fn version(&self) -> String {
        let v = self.version;
        format!("{}.{}.{}", v / 10_000, v / 100 % 100, v % 100)
    }

    /// Filters a lightmap of `width × height` texels (rows one after another, linear colour, values
    /// from 0 upwards in any unit) with the filter made for them, at its highest quality. Returns
    /// as many texels; `color` is left as it is.
    ///
    /// # Errors
    /// A number of texels other than `width · height`, none at all, or what the library says: too
    /// large an image, no memory.
    pub fn lightmap(
        &self,
        width: usize,
        height: usize,
        color: &[Vec3],
    ) -> Result<Vec<Vec3>, String> {
        if color.is_empty() || width.checked_mul(height) != Some(color.len()) {
            return Err(format!(
                "a lightmap of {width} × {height} texels cannot have {}",
                color.len()
            ));
        }
        let mut output = vec![Vec3::ZERO; color.len()];
        let f = &self.functions;
        let filter = Filter {
            // SAFETY: the device is live and committed, the name NUL-terminated.
            raw: unsafe { (f.new_filter)(self.device, c"RTLightmap".as_ptr()) },
            release: f.release_filter,
        };
        if filter.raw.is_null() {
            self.check()?;
            return Err("Open Image Denoise has no filter for lightmaps".into());
        }
        // SAFETY: the filter is live. Both images hold `width · height` texels of three floats
        // without gaps (strides of 0 say so), and outlive the filter's execution, which ends before
        // it returns. Nothing is written to the image named "color".
        unsafe {
            let input = color.as_ptr().cast_mut().cast();
            (f.set_image)(
                filter.raw,
                c"color".as_ptr(),
                input,
                FORMAT_FLOAT3,
                width,
                height,
                0,
                0,
                0,
            );
            let result = output.as_mut_ptr().cast();
            (f.set_image)(
                filter.raw,
                c"output".as_ptr(),
                result,
                FORMAT_FLOAT3,
                width,
                height,
                0,
                0,
                0,
            );
            (f.commit_filter)(filter.raw);
        }
        self.check()?;
        // SAFETY: the filter is live and was committed without error; its images are as said above.
        unsafe { (f.execute_filter)(filter.raw) };
        self.check()?;
        Ok(output)
    }

    /// The first error that the library reported on this thread since it was last asked.
    fn check(&self) -> Result<(), String> {
        let mut message: *const c_char = std::ptr::null();
        // SAFETY: the device is live, or null, which asks for the creation of devices.
        let code = unsafe { (self.functions.device_error)(self.device, &raw mut message) };
        if code == ERROR_NONE {
            return Ok(());
        }
        if message.is_null() {
            return Err(format!("Open Image Denoise reports error {code}"));
        }
        // SAFETY: the library hands out a NUL-terminated text that lives until the next call; it is
        // copied at once.
        let text = unsafe { CStr::from_ptr(message) }.to_string_lossy();
        Err(format!("Open Image Denoise reports error {code}: {text}"))
    }
}

impl Drop for Denoiser {
    fn drop(&mut self) {
        if !self.device.is_null() {
            // SAFETY: the device is owned here and not used afterwards; its filters hold references
            // of their own.
            unsafe { (self.functions.release_device)(self.device) };
        }
    }
}

/// Owner of a filter.
struct Filter {
    raw: Handle,
    release: unsafe extern "C" fn(Handle),
}

impl Drop for Filter {
    fn drop(&mut self) {
        if !self.raw.is_null() {
            // SAFETY: the filter is owned here and not used afterwards.
            unsafe { (self.release)(self.raw) };
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// What every message of a failed opening must say.
    fn assert_helps(error: &str, file: &str) {
        for needed in [file, "--oidn FILE", VARIABLE, "scripts/compare oidn"] {
            assert!(error.contains(needed), "{needed:?} is missing: {error}");
        }
    }

    #[test]
    fn a_missing_library_is_named_with_the_way_out() {
        let missing = "/nonexistent/libOpenImageDenoise.so.2";
        let error = Denoiser::open(Some(Path::new(missing)), 1)
            .err()
            .expect("there is no such file");
        assert_helps(&error, missing);
        assert_eq!(error.matches(missing).count(), 1, "named twice: {error}");
    }

    #[test]
    fn another_library_is_no_denoiser() {
        // the C library is always there, and has none of the functions
        let error = Denoiser::open(Some(Path::new("libc.so.6")), 1)
            .err()
            .expect("no denoiser");
        assert_helps(&error, "libc.so.6");
        assert!(error.contains("oidnNewDevice"), "{error}");
    }

    #[test]
    fn noise_on_an_even_lightmap_is_taken_out_where_the_library_is_found() {
        const SIDE: usize = 64;
        let variable = std::env::var(VARIABLE).ok().filter(|v| !v.is_empty());
        let denoiser = match Denoiser::open(None, 2) {
            Ok(denoiser) => denoiser,
            Err(error) => return assert_helps(&error, variable.as_deref().unwrap_or(NAMES[0])),
        };
        assert!(
            denoiser.version().starts_with("2."),
            "{}",
            denoiser.version()
        );
        let mut rng = crate::core::sampling::KeyedRng::new(1, 2);
        let noisy: Vec<Vec3> = (0..SIDE * SIDE)
            .map(|_| Vec3::new(2.0, 1.0, 0.5) * (0.5 + rng.below(1001) as f32 * 1e-3))
            .collect();
        let filtered = denoiser.lightmap(SIDE, SIDE, &noisy).expect("filters");
        let scatter =
            |v: &[Vec3]| v.iter().map(|e| (e.y - 1.0).powi(2)).sum::<f32>() / v.len() as f32;
        assert!(
            scatter(&filtered) < 0.1 * scatter(&noisy),
            "{} of {}",
            scatter(&filtered),
            scatter(&noisy)
        );
        let wrong = denoiser
            .lightmap(SIDE, SIDE + 1, &noisy)
            .expect_err("one row short");
        assert!(
            wrong.contains("64 × 65") && wrong.contains("4096"),
            "{wrong}"
        );
        assert!(
            denoiser.lightmap(0, 0, &[]).is_err()
                && denoiser.lightmap(usize::MAX, 2, &noisy).is_err()
        );
    }
}

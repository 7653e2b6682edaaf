//! Embree: a committed triangle scene and batch queries against it.
//!
//! [`TriangleScene::build`] consumes plain arrays and returns a scene that is already committed and
//! can never change again; only that type traces, hence it may be shared between threads.
//! Structures and constants come from the headers of the Embree the program is linked to
//! (`build.rs`), and the library met at run time is compared with them before use.

use super::ray::{Hit, Ray};
use std::ffi::{CStr, CString, c_char, c_void};
use std::sync::Mutex;

/// What bindgen made of Embree's headers and of `ffi/trace_shim.h`.
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
    include!(concat!(env!("OUT_DIR"), "/embree_bindings.rs"));
}

const _: () = assert!(size_of::<Ray>() == size_of::<sys::UnbakeRay>() && size_of::<Ray>() == 32);
const _: () = assert!(size_of::<Hit>() == size_of::<sys::UnbakeHit>() && size_of::<Hit>() == 16);
const _: () = assert!(Hit::MISS == u32::MAX);

/// Version of the headers the program was built with, such as `4.3.3`.
pub const HEADER_VERSION: &str = env!("UNBAKE_EMBREE_HEADERS");

/// Messages Embree reported through its callback, which may run on any of its threads.
#[derive(Default)]
struct ErrorLog(Mutex<Vec<String>>);

impl ErrorLog {
    fn take(&self) -> Vec<String> {
        std::mem::take(
            &mut *self
                .0
                .lock()
                .unwrap_or_else(std::sync::PoisonError::into_inner),
        )
    }
}

/// Embree's error callback: stores the message.
unsafe extern "C" fn collect_error(user: *mut c_void, code: sys::RTCError, text: *const c_char) {
    if user.is_null() {
        return;
    }
    // SAFETY: `user` is the `ErrorLog` registered by `Device::new`, which outlives the device (see
    // its drop).
    let log = unsafe { &*user.cast::<ErrorLog>() };
    let text = if text.is_null() {
        String::new()
    } else {
        // SAFETY: Embree passes a NUL-terminated string that lives for the duration of the call.
        unsafe { CStr::from_ptr(text) }
            .to_string_lossy()
            .into_owned()
    };
    let mut messages = log
        .0
        .lock()
        .unwrap_or_else(std::sync::PoisonError::into_inner);
    // A broken scene can fail once per primitive: a few messages say it all.
    if messages.len() < 8 {
        messages.push(
            format!("{} {text}", error_name(code))
                .trim_end()
                .to_string(),
        );
    }
}

fn error_name(code: sys::RTCError) -> &'static str {
    match code {
        sys::RTC_ERROR_NONE => "no error",
        sys::RTC_ERROR_INVALID_ARGUMENT => "invalid argument",
        sys::RTC_ERROR_INVALID_OPERATION => "invalid operation",
        sys::RTC_ERROR_OUT_OF_MEMORY => "out of memory",
        sys::RTC_ERROR_UNSUPPORTED_CPU => "unsupported CPU",
        sys::RTC_ERROR_CANCELLED => "cancelled",
        _ => "unknown error",
    }
}

/// The instruction set asked of Embree: `UNBAKE_EMBREE_ISA` if set (`native` leaves the choice to
/// Embree), else AVX2.
///
/// Which of two triangles at exactly the same distance is returned depends on the instruction set
/// (2 % of rays in a test), so that the same bits on different machines need the same one.
fn device_config() -> Result<String, String> {
    let wanted = match std::env::var("UNBAKE_EMBREE_ISA") {
        Ok(isa) if !isa.is_empty() => isa,
        _ if avx2_available() => "avx2".into(),
        _ => "native".into(),
    };
    match wanted.as_str() {
        "native" => Ok(String::new()),
        "sse2" | "sse4.2" | "avx" | "avx2" | "avx512" => Ok(format!("isa={wanted}")),
        other => Err(format!(
            "UNBAKE_EMBREE_ISA={other}: expected native, sse2, sse4.2, avx, avx2 or avx512"
        )),
    }
}

#[cfg(target_arch = "x86_64")]
fn avx2_available() -> bool {
    std::is_x86_feature_detected!("avx2")
}

#[cfg(not(target_arch = "x86_64"))]
fn avx2_available() -> bool {
    false
}

/// Owner of an Embree device and of the log its callback writes to.
struct Device {
    raw: sys::RTCDevice,
    log: *mut ErrorLog,
}

impl Device {
    fn new() -> Result<Self, String> {
        let config = CString::new(device_config()?).map_err(|e| e.to_string())?;
        // SAFETY: the configuration is a NUL-terminated string; Embree copies it.
        let raw = unsafe { sys::rtcNewDevice(config.as_ptr()) };
        if raw.is_null() {
            // SAFETY: a null device asks for the error of device creation on this thread.
            let code = unsafe { sys::rtcGetDeviceError(std::ptr::null_mut()) };
            return Err(format!(
                "Embree could not start ({}; {})",
                error_name(code),
                config.to_string_lossy()
            ));
        }
        let device = Self {
            raw,
            log: Box::into_raw(Box::new(ErrorLog::default())),
        };
        // SAFETY: the device is live, and the log behind the user pointer is freed only after the
        // device was released.
        unsafe { sys::rtcSetDeviceErrorFunction(raw, Some(collect_error), device.log.cast()) };
        device.check_version()?;
        Ok(device)
    }

    fn version(&self) -> (i64, i64, i64) {
        let property = |p| {
            // SAFETY: the device is live and the property is one every version knows.
            unsafe { sys::rtcGetDeviceProperty(self.raw, p) as i64 }
        };
        (
            property(sys::RTC_DEVICE_PROPERTY_VERSION_MAJOR),
            property(sys::RTC_DEVICE_PROPERTY_VERSION_MINOR),
            property(sys::RTC_DEVICE_PROPERTY_VERSION_PATCH),
        )
    }

    /// A library older than the headers, or of another major version, may lay its structures out
    /// differently.
    fn check_version(&self) -> Result<(), String> {
        let (major, minor, patch) = self.version();
        let built = (
            i64::from(sys::RTC_VERSION_MAJOR),
            i64::from(sys::RTC_VERSION_MINOR),
        );
        if major == built.0 && minor >= built.1 {
            return Ok(());
        }
        Err(format!(
            "built with the headers of Embree {HEADER_VERSION} but Embree {major}.{minor}.{patch} was loaded; \
             rebuild unbake against the installed Embree or mend LD_LIBRARY_PATH"
        ))
    }

    /// Fails if Embree reported anything since the last call.
    fn check(&self, doing: &str) -> Result<(), String> {
        // SAFETY: the log lives as long as `self`.
        let messages = unsafe { &*self.log }.take();
        if messages.is_empty() {
            Ok(())
        } else {
            Err(format!("Embree failed {doing}: {}", messages.join("; ")))
        }
    }
}

impl Drop for Device {
    fn drop(&mut self) {
        // SAFETY: `raw` is owned here and not used afterwards; with the last reference gone no
        // callback can run, so the log, which was made by `Box::into_raw`, can be freed.
        unsafe {
            sys::rtcReleaseDevice(self.raw);
            drop(Box::from_raw(self.log));
        }
    }
}

/// How many rays an occlusion query hands to Embree at once.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PacketWidth {
    /// One at a time.
    One = 1,
    /// Eight.
    Eight = 8,
    /// Sixteen.
    Sixteen = 16,
}

/// A committed, immutable scene of triangles.
pub struct TriangleScene {
    raw: sys::RTCScene,
    device: Device,
}

// SAFETY: a committed scene may be queried from any number of threads at once (Embree API,
// "Multi-Threading"); it is never modified after `build`, and the device's log is behind a mutex.
unsafe impl Sync for TriangleScene {}
// SAFETY: Embree handles are not bound to the thread that made them.
unsafe impl Send for TriangleScene {}

impl TriangleScene {
    /// Builds and commits a scene: high quality (splits triangles; 4 to 7 % more rays per second),
    /// neither robust nor compact (robust costs 11–13 % of speed, compact a quarter or more, and
    /// both silently turn high quality into medium).
    ///
    /// Every index must be below `positions.len()` and every position finite; the caller has
    /// checked it, and it is checked again here because Embree would read out of bounds.
    ///
    /// # Errors
    /// In the library's own words: Embree is missing, or refuses the scene.
    pub fn build(positions: &[[f32; 3]], triangles: &[[u32; 3]]) -> Result<Self, String> {
        if triangles
            .iter()
            .flatten()
            .any(|&i| i as usize >= positions.len())
        {
            return Err("a triangle names a vertex that does not exist".into());
        }
        if u32::try_from(triangles.len()).is_err() {
            return Err(format!(
                "{} triangles: Embree takes at most {}",
                triangles.len(),
                u32::MAX
            ));
        }
        let device = Device::new()?;
        // SAFETY: the device is live.
        let raw = unsafe { sys::rtcNewScene(device.raw) };
        if raw.is_null() {
            device.check("making a scene")?;
            return Err("Embree failed making a scene".into());
        }
        let scene = Self { raw, device };
        // SAFETY: the scene is live and not yet committed.
        unsafe {
            sys::rtcSetSceneBuildQuality(scene.raw, sys::RTC_BUILD_QUALITY_HIGH);
            sys::rtcSetSceneFlags(scene.raw, sys::RTC_SCENE_FLAG_NONE);
        }
        if !triangles.is_empty() {
            scene.attach(positions, triangles)?;
        }
        // SAFETY: the scene is live; the build runs on Embree's own threads and this one, and
        // returns when complete.
        unsafe { sys::rtcCommitScene(scene.raw) };
        scene
            .device
            .check("building the scene (is there enough memory?)")?;
        Ok(scene)
    }

    fn attach(&self, positions: &[[f32; 3]], triangles: &[[u32; 3]]) -> Result<(), String> {
        // SAFETY: the device is live.
        let geometry =
            unsafe { sys::rtcNewGeometry(self.device.raw, sys::RTC_GEOMETRY_TYPE_TRIANGLE) };
        if geometry.is_null() {
            self.device.check("making a geometry")?;
            return Err("Embree failed making a geometry".into());
        }
        let filled = self
            .fill(
                geometry,
                sys::RTC_BUFFER_TYPE_VERTEX,
                sys::RTC_FORMAT_FLOAT3,
                positions,
            )
            .and_then(|()| {
                // Triangle indices are u32 in both.
                self.fill(
                    geometry,
                    sys::RTC_BUFFER_TYPE_INDEX,
                    sys::RTC_FORMAT_UINT3,
                    triangles,
                )
            });
        // SAFETY: the geometry is live; attaching makes the scene hold its own reference, so ours
        // is released last.
        unsafe {
            if filled.is_ok() {
                // The default mask is all ones in Embree 3 and 1 in Embree 4: rays carry all ones,
                // and so does this.
                sys::rtcSetGeometryMask(geometry, u32::MAX);
                sys::rtcSetGeometryBuildQuality(geometry, sys::RTC_BUILD_QUALITY_HIGH);
                sys::rtcCommitGeometry(geometry);
                sys::rtcAttachGeometry(self.raw, geometry);
            }
            sys::rtcReleaseGeometry(geometry);
        }
        filled?;
        self.device.check("attaching the mesh")
    }

    /// Copies `data` into a buffer that Embree allocates, aligns and pads (it reads 16 bytes per
    /// vertex).
    fn fill<T: bytemuck::Pod>(
        &self,
        geometry: sys::RTCGeometry,
        kind: sys::RTCBufferType,
        format: sys::RTCFormat,
        data: &[T],
    ) -> Result<(), String> {
        // SAFETY: the geometry is live, and format and stride describe `T` (three 4-byte numbers).
        let target = unsafe {
            sys::rtcSetNewGeometryBuffer(geometry, kind, 0, format, size_of::<T>(), data.len())
        };
        if target.is_null() {
            self.device.check("allocating the mesh")?;
            return Err(format!(
                "Embree could not allocate {} bytes",
                size_of_val(data)
            ));
        }
        // SAFETY: Embree returned room for `data.len()` elements of `size_of::<T>()` bytes,
        // suitably aligned, not overlapping ours; `T` is plain data.
        unsafe { std::ptr::copy_nonoverlapping(data.as_ptr(), target.cast::<T>(), data.len()) };
        Ok(())
    }

    /// Closest hits on the calling thread. Rays that are not finite, or have no direction, miss.
    ///
    /// # Panics
    /// If the slices differ in length.
    pub fn closest(&self, rays: &[Ray], hits: &mut [Hit]) {
        assert_eq!(rays.len(), hits.len(), "one hit per ray");
        // SAFETY: the scene is committed; both arrays have `rays.len()` elements of the layouts
        // asserted above.
        unsafe {
            sys::unbake_closest(
                self.raw,
                rays.as_ptr().cast(),
                hits.as_mut_ptr().cast(),
                rays.len(),
            )
        }
    }

    /// Occlusion on the calling thread: 1 where anything lies on the segment, else 0.
    ///
    /// # Panics
    /// If the slices differ in length.
    pub fn occluded(&self, rays: &[Ray], occluded: &mut [u8], width: PacketWidth) {
        assert_eq!(rays.len(), occluded.len(), "one flag per ray");
        // SAFETY: as in `closest`.
        unsafe {
            sys::unbake_occluded(
                self.raw,
                rays.as_ptr().cast(),
                occluded.as_mut_ptr(),
                rays.len(),
                width as i32,
            )
        }
    }

    /// The yardstick of the benchmarks: a plain C++ loop of closest-hit queries. Returns the number
    /// of hits. Rays must be finite.
    #[must_use]
    pub fn bare_closest(&self, rays: &[Ray]) -> usize {
        // SAFETY: the scene is committed and the array has `rays.len()` rays.
        unsafe { sys::unbake_bare_closest(self.raw, rays.as_ptr().cast(), rays.len()) }
    }

    /// The yardstick of the benchmarks: a plain C++ loop of occlusion queries. Returns the number
    /// of blocked rays. Rays must be finite.
    #[must_use]
    pub fn bare_occluded(&self, rays: &[Ray]) -> usize {
        // SAFETY: as in `bare_closest`.
        unsafe { sys::unbake_bare_occluded(self.raw, rays.as_ptr().cast(), rays.len()) }
    }

    /// Version of the library in use, such as `4.3.3`.
    #[must_use]
    pub fn library_version(&self) -> String {
        let (major, minor, patch) = self.device.version();
        format!("{major}.{minor}.{patch}")
    }
}

impl Drop for TriangleScene {
    fn drop(&mut self) {
        // SAFETY: the scene is owned here and no query can be running (`&mut self`); the device, a
        // field, goes after it.
        unsafe { sys::rtcReleaseScene(self.raw) };
    }
}

/// Version of the Embree found at run time, without building a scene.
///
/// # Errors
/// If Embree cannot be started.
pub fn library_version() -> Result<String, String> {
    let (major, minor, patch) = Device::new()?.version();
    Ok(format!("{major}.{minor}.{patch}"))
}

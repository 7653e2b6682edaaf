//! The border to native code: the only `unsafe` of the program.
//!
//! Each submodule owns one library or one machine feature behind safe types; every block says which
//! rule permits it.

#[allow(unsafe_code)]
pub mod basis;
#[allow(unsafe_code)]
pub mod clock;
#[allow(unsafe_code)]
pub mod embree;
#[allow(unsafe_code)]
pub mod meshopt;
#[allow(unsafe_code)]
pub mod oidn;
#[allow(unsafe_code)]
pub mod oiio;
pub mod ray;
#[allow(unsafe_code)]
pub mod simd;

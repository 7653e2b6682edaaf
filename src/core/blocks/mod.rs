//! Work that several processes share in blocks: the division, the bytes of a result, and the
//! transports. Stages share work by [`Progress::share`](super::progress::Progress::share).

mod folder;
mod packed;
#[cfg(feature = "mpi")]
mod ranks;
mod work;

pub use folder::{BlockFolder, CallState, Shard};
pub use packed::{Columns, Packed, column, flags, opened, sealed, truths, values};
#[cfg(feature = "mpi")]
pub use ranks::Ranks;
pub use work::{Division, Transport, Work};

//! Work that several processes share in blocks: the division, the bytes of a result, and the
//! transports. Stages share work by [`Progress::share`](super::progress::Progress::share).

mod folder;
mod packed;
mod work;

pub use folder::{BlockFolder, Shard};
pub use packed::{Columns, Packed, column, opened, sealed, truths, values};
pub use work::{Division, Transport, Work};

//! Many scenes as pieces of work that any number of processes share: the list, the board on which
//! they find work and put down what became of it, and the merged table. Called by `unbake batch`.

mod board;
mod list;
mod record;
mod table;

pub use board::Board;
pub use list::{Item, read_list};
pub use record::{SceneRecord, State};
pub use table::Table;

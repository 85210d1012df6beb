//! Files that a user names: only regular ones are read, of limited size, and errors show little of
//! them. A file or a folder is written whole or not at all.

mod cache;
mod kind;
mod open_folder;
mod quoted;
mod regular;
mod shortened;
mod unfinished;
mod whole_file;
mod whole_folder;
mod word;

pub use cache::cache_folder;
pub use kind::{KIND_BYTES, TEXT, binary_kind_of, is_hidden, is_pickle, is_unfinished, kind_of};
pub use open_folder::{EntryKind, OpenFolder};
pub use quoted::quoted;
pub use regular::{open, read, read_text, target};
pub use shortened::shortened;
pub use unfinished::UNFINISHED;
pub use whole_file::{WholeFile, write_whole, write_within};
pub use whole_folder::WholeFolder;
pub use word::{path_of, serde_path, word_of};

/// Largest file of settings, prompts or a study, bytes.
pub const MAX_SETTINGS_BYTES: u64 = 1 << 20;
/// Largest list of scenarios, or file of a run in TOML, bytes.
pub const MAX_LIST_BYTES: u64 = 64 << 20;

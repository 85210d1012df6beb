//! Tables of the lab's results.

mod bench;
mod costs;
mod realism;
mod recordings;
mod reported;
mod study;
mod tokens;
mod twins;

pub use bench::{bench_markdown, bench_table};
pub use realism::realism_table;
pub(crate) use study::study_markdown;
pub use study::study_table;
pub use tokens::{token_markdown, token_table};
pub use twins::twin_table;
pub(crate) use twins::{twin_markdown, twin_rows};

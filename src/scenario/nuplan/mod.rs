//! nuPlan's data: log databases (`.db`), map packages (`map.gpkg`), and the scenarios that a
//! `ScenarioFilter` picks from them.
//!
//! * `schema`, `database`: tables and columns, and access to them;
//! * `logs`, `side_index`: logs on disk, which are never written;
//! * `filter`, `filter_file`, `search`, `filter_steps`, `exclusion`: the scenarios that a filter
//!   takes;
//! * `extraction`, `rows`, `route`, `velocity`, `open`: a scenario as [`super::Scenario`];
//! * [`geometry_blob`], [`projection`], `layers`, `lane_map`, `map_store`: the map around it;
//! * `reader`, `split`: words of the command line, and published lists;
//! * [`export`]: writes any scenario as a log and its map.
//!
//! Logs and maps are read as the queries of the nuPlan devkit read them. Damage is an error that
//! names file, table, row and column.

mod database;
mod error;
mod exclusion;
pub mod export;
mod extraction;
mod filter;
mod filter_file;
mod filter_steps;
pub mod geometry_blob;
mod lane_map;
mod layers;
mod logs;
mod map_store;
mod open;
pub mod projection;
mod reader;
mod route;
mod rows;
mod schema;
mod search;
mod side_index;
mod split;
mod token;
mod velocity;

pub use error::{CellFault, CellPlace, FileFault, NuPlanError, RouteFault, RowName, ScenarioFault};
pub use exclusion::{Exclusion, Exclusions};
pub use extraction::Extraction;
pub(crate) use filter::THRESHOLD_KEY;
pub use filter::{Limit, ScenarioFilter, ThresholdScope, TokenSet};
pub use filter_file::{FilterError, FilterFault, FilterFile};
pub use lane_map::NuPlanMap;
pub use logs::{Log, LogScenario, Logs, UnreadableLog};
pub use map_store::MapStore;
pub use open::open;
pub use reader::NuPlanReader;
pub use schema::MAPS_INDEX;
pub use search::{SearchResult, search};
pub use split::{PUBLISHED_SPLITS, PublishedSplit, SplitError};
pub use token::{TOKEN_BYTES, Token, TokenError};

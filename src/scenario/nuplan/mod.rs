//! nuPlan's data: log databases (`.db`), map packages (`map.gpkg`), and the scenarios that a `ScenarioFilter` picks from them.
//!
//! * `logs`, `schema`, `database`, `side_index`: finding and reading logs, without ever writing to them;
//! * `filter`, `filter_file`, `search`, `thinning`, `exclusion`: which scenarios there are and which of them are wanted;
//! * `extraction`, `rows`, `open`, `route`: a scenario as [`super::Scenario`];
//! * `map_store`, `layers`, `lane_map`, [`geometry_blob`], [`projection`]: the map around it;
//! * `reader`, `split`: words of the command line and published lists;
//! * [`export`]: the way back, from any scenario to a log and its map.
//!
//! Logs and maps are read as the nuPlan devkit's queries read them. What is damaged is an error that names file, table, row and
//! column.

mod database;
mod error;
mod exclusion;
pub mod export;
mod extraction;
mod filter;
mod filter_file;
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
mod thinning;
mod token;

pub use error::{CellFault, CellPlace, NuPlanError, RowName, ScenarioFault};
pub use exclusion::{Exclusion, Exclusions};
pub use extraction::{Extraction, MAPPED_TYPES, ROWS_PER_STEP};
pub use filter::{Limit, ScenarioFilter, THRESHOLD_KEY, ThresholdScope, TokenSet};
pub use filter_file::{FilterError, FilterFault, FilterFile};
pub use logs::{Log, Logs, MAX_FOLDER_DEPTH};
pub use map_store::{MAPS_INDEX, MapStore, NuPlanMap};
pub use open::open;
pub use reader::{LogWordError, NuPlanReader};
pub use route::RouteFault;
pub use search::{LogScenario, SearchResult, UnreadableLog, search, tag_types};
pub use split::SplitError;
pub use token::{TOKEN_BYTES, Token, TokenError};

//! PDM-Closed: the record of upstream's own runs, and hand-worked cases.

mod record;
mod route;
mod steps;
mod town;

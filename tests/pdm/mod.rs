//! PDM-Closed: the record of upstream's own runs, and hand-worked cases.

mod forecast;
mod record;
mod route;
mod scorer;
mod steps;
mod town;

//! nuPlan's formats: what is written reads back, by our reader and by the public ones.

mod command;
mod compare;
mod public_readers;
mod recorded;
mod round_trip;

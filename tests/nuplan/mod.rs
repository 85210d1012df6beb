//! nuPlan's formats: our reader and public readers read what is written.

mod command;
mod compare;
mod devkit;
mod public_readers;
mod recorded;
mod round_trip;

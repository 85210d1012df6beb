//! GC-PGP's network (`tuplan_garage` `pgp/`, after `nachiket92/PGP`).

mod aggregator;
mod encoder;
mod network;

pub use network::{GcPgp, GcPgpInputs, GcPgpScene};

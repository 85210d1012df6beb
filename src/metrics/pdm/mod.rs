//! PDM scorer.

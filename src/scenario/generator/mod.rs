//! Seeded generator of drives.

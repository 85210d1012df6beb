//! Files that are hostile, and files that say what a checkpoint says.

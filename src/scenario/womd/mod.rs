//! Waymo Open Motion recordings.

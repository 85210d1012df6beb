//! Learned planners: networks, features and checkpoints against the values of the originals.

mod checkpoint;
mod dtpp;
mod gameformer;
mod gc_pgp;
mod pdm_open;
mod plantf;
mod program;
mod raster_model;
mod scene;
mod urban_driver;
mod vectors;

//! Learned planners: networks, features and checkpoints against the values of the originals.

mod checkpoint;
mod dtpp;
mod exported;
mod gameformer;
mod gc_pgp;
mod odd_scenes;
mod pdm_open;
mod plantf;
mod program;
mod raster_model;
mod scene;
mod trained;
mod urban_driver;
mod vectors;

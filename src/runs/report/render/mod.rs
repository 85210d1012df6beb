//! A simulation as a picture or a film, drawn as the page draws it: the scene with lights, plans
//! and a scale, a legend, and a caption. One planning call as a picture.

mod call;
mod canvas;
mod caption;
mod colors;
mod error;
mod film;
mod find;
mod frame;
mod legend;
mod lettering;
mod observed;
mod palette;
mod scene;
mod score_labels;

pub use call::{call_picture, code_picture};
pub use error::{OutputFault, RenderError};
pub use film::{write_gif, write_mp4};
pub use find::{SimulationChoice, named, words};
pub use frame::{Film, Look};
pub use observed::observed_picture;

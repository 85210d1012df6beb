//! A drive as a picture or a film: the BEV map as the model's is drawn, with the plan in force and the refused ones on the road,
//! and what there is to say in a caption below.

mod caption;
mod error;
mod film;
mod find;
mod frame;

pub use error::RenderError;
pub use film::{write_gif, write_mp4};
pub use find::SimulationChoice;
pub use frame::{Film, Look};

//! A simulation as a picture or a film: the BEV map in the model's style with the active plan and the refused plans, and a caption
//! below.

mod caption;
mod error;
mod film;
mod find;
mod frame;

pub use error::{OutputFault, RenderError};
pub use film::{write_gif, write_mp4};
pub use find::SimulationChoice;
pub use frame::{Film, Look};

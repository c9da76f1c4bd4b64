//! Gaussians as virtual transmitters, coherent over the room: the field, its derivative, gains, search and refinement.

mod cis;
mod descent;
mod field;
mod harmonics;
mod images;
mod links;
mod matching_pursuit;
mod method;
mod normal;
mod options;
mod pursuit;
mod rows;
mod solve;
mod sweep;
mod turn;

pub use field::{FieldVjp, HARMONICS, field, field_vjp};
pub use links::{Links, Sources};
pub use matching_pursuit::MatchingPursuit;
pub use method::VirtualTransmitters;
pub use options::{Progress, Pursuit};
pub use pursuit::{pursue, snr_of};
pub use solve::solve_gains;

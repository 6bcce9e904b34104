//! Truth + reconstruction → scores, one file per protocol.
//!
//! [`points`] and [`evaluation`] are what the protocols share; [`plain`] judges clouds that share a
//! frame, [`tnt`] follows the Tanks and Temples toolbox by way of [`cameras`] and [`refine`]. Nothing
//! here knows a path.

pub mod bootstrap;
pub mod cameras;
pub mod depth;
pub mod evaluation;
pub mod gates;
pub mod plain;
pub mod points;
pub mod refine;
pub mod sample;
pub mod tnt;

pub use evaluation::{Evaluation, Side, SideCounts};
pub use points::FinitePoints;

//! Self-contained HTML reports: inline SVG and CSS, nothing fetched. A script of the page's own makes
//! it move; without it everything is there to be read.

mod axis;
pub mod bars;
pub mod chart;
pub mod comparison;
pub mod diagnosis;
pub mod exam;
pub mod experiment;
pub mod fleet;
pub mod flight;
mod flight_page;
mod frame;
pub mod histogram;
pub mod limited;
pub mod metrics;
pub mod onset;
pub mod page;
pub mod plan;
mod power;
pub mod recording;
mod recording_page;
pub mod repair;
pub mod scene;
pub mod side_by_side;
pub mod table;
pub mod text;
pub mod training;

pub use flight::FlightReport;
pub use recording::Recording;

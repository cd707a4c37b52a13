//! Self-contained HTML reports: inline SVG and CSS, nothing fetched, no script.

mod axis;
pub mod chart;
pub mod diagnosis;
pub mod flight;
mod flight_page;
pub mod histogram;
pub mod page;
pub mod scene;
pub mod table;
pub mod training;

pub use flight::FlightReport;

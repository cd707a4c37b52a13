//! Self-contained HTML reports: inline SVG and CSS, nothing fetched, no script.

pub mod chart;
pub mod flight;
mod flight_page;
pub mod page;
pub mod scene;
pub mod table;

pub use flight::FlightReport;

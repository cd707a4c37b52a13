//! Self-contained HTML reports: inline SVG and CSS, nothing fetched, no script.

mod axis;
pub mod chart;
pub mod comparison;
pub mod diagnosis;
pub mod exam;
pub mod experiment;
pub mod flight;
mod flight_page;
pub mod histogram;
pub mod limited;
pub mod metrics;
pub mod page;
pub mod plan;
pub mod repair;
pub mod scene;
pub mod table;
pub mod training;
pub mod words;

pub use flight::FlightReport;

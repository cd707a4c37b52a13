//! Minimum-time plans through waypoints and gates, within each rotor's thrust.

mod bounds;
mod course;
mod flight;
mod guess;
mod knots;
mod planner;
mod rotor_dynamics;
mod search;
mod spline;
mod task;

pub use course::{Course, Finish, Gate, Limits, Margin, Passage, Start};
pub use flight::{FlightPlan, FlightPlanner};
pub use knots::{Knots, Period};
pub use planner::{Settings, Stop, TimeOptimal, plan};
pub use rotor_dynamics::RotorDynamics;
pub use task::{NoWay, Task, Wishes};

//! Diagnosis of the gap between a simulator and flights: where it lies, which effect causes it,
//! how far it shrinks.

pub mod answer;
pub mod arrival;
pub mod audit;
pub mod candidate;
pub mod fit;
pub mod flight_simulator;
pub mod gap;
pub mod hypothesis;
mod inquiry;
pub mod judgement;
pub mod layout;
pub mod learner;
pub mod leftover;
pub mod linearised;
pub mod map;
pub mod misfit;
mod naming;
pub mod next_flight;
pub mod noise;
pub mod observed;
pub mod onboard;
pub mod preparation;
pub mod procedure;
pub mod reflight;
pub mod replica;
pub mod residuals;
pub mod selection;
pub mod series;
mod setpoints;
pub mod spectrum;
pub mod strain;
mod tolerances;
pub mod turbulence;
pub mod twins;
mod unchosen;
pub mod words;

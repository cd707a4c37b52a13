//! From flight logs to what a simulator lacks.

pub mod audit;

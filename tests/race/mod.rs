//! The racing quadrotor of published courses, and a judge of what is planned for it.

// The bench has them too.
pub mod course;
pub mod judge;

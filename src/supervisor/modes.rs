//! The autopilot's modes, by number and name.

/// The custom modes that the supervisor needs, and the names of all.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ModeMap {
    /// The autopilot's name.
    pub autopilot: &'static str,
    /// The mode that obeys setpoints.
    pub offboard: u32,
    /// The mode that keeps its place, or stays on the ground, without setpoints. `None` where there
    /// is none.
    pub hold: Option<u32>,
    /// The mode that lands where the vehicle is.
    pub land: u32,
    /// Whether CURRENT_MODE reports the intended mode, which must then be known before streaming.
    pub reports_intended: bool,
    /// The names of all its modes.
    pub names: &'static [(u32, &'static str)],
}

impl ModeMap {
    /// The name of a mode, or its number where it has no name.
    pub fn name(&self, mode: u32) -> String {
        match self.names.iter().find(|(named, _)| *named == mode) {
            Some((_, name)) => (*name).to_owned(),
            None => format!("mode {mode:#010x}"),
        }
    }
}

//! The modes of the vehicle's autopilot, as words.

/// Custom modes of the vehicle's autopilot.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ModeMap {
    /// The autopilot's name.
    pub autopilot: &'static str,
    /// Obeys setpoints.
    pub offboard: u32,
    /// Stays where it is, or stands; needs no setpoints. `None` where there is none.
    pub hold: Option<u32>,
    /// Lands where it is.
    pub land: u32,
    /// Whether CURRENT_MODE tells the intended mode, so that it must be known before streaming.
    pub reports_intended: bool,
    /// The names of all its modes.
    pub names: &'static [(u32, &'static str)],
}

impl ModeMap {
    /// A mode by its name, or by its number where it has none.
    pub fn name(&self, mode: u32) -> String {
        match self.names.iter().find(|(named, _)| *named == mode) {
            Some((_, name)) => (*name).to_owned(),
            None => format!("mode {mode:#010x}"),
        }
    }
}

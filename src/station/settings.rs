//! What a station is made of.

use std::sync::Arc;

use vehicle::AttitudePd;

use crate::control::{Actuation, ControlSettings, HoverVehicle};
use crate::link::session;
use crate::offboard::OffboardSettings;
use crate::plan::reference::ReferenceSource;
use crate::supervisor::EngagePolicy;

/// What a station needs to fly a vehicle.
#[derive(Clone)]
pub struct StationSettings {
    /// The session.
    pub session: session::Settings,
    /// Settings of the offboard controller's parts.
    pub offboard: OffboardSettings,
    /// The control law and its settings.
    pub control: ControlSettings,
    /// Who decides that a flight begins.
    pub policy: EngagePolicy,
    /// Effective mass, inertia and gravity.
    pub hover: HoverVehicle,
    /// Drag over speed along front and right, and along down, as far as it is known, kg/s.
    pub drag_kg_s: [f64; 2],
    /// Thrust of all rotors at full output, N.
    pub thrust_full_n: f64,
    /// The pack's voltage when full, V.
    pub battery_full_v: f64,
    /// The on-board loop as it is, whatever of the setpoint it is sent; `None` where it is the
    /// autopilot's own.
    pub attitude_pd: Option<AttitudePd>,
    /// How late the vehicle answers.
    pub actuation: Actuation,
    /// What is flown.
    pub reference: Arc<dyn ReferenceSource + Send + Sync>,
    /// How long no vehicle is heard, at first or since the last word of one, before the search is
    /// given up, s; `None` waits for ever.
    pub search_timeout_s: Option<f64>,
}

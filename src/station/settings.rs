//! The settings of a station.

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
    /// The session with the vehicle.
    pub session: session::Settings,
    /// The settings of the control path's parts.
    pub offboard: OffboardSettings,
    /// The control law and its settings.
    pub control: ControlSettings,
    /// Who decides that a flight begins.
    pub policy: EngagePolicy,
    /// Effective mass, inertia and gravity.
    pub hover: HoverVehicle,
    /// Drag per speed, kg/s: along front and right, and along down; as far as known.
    pub drag_kg_s: [f64; 2],
    /// Thrust of all rotors at full output, N.
    pub thrust_full_n: f64,
    /// The pack's voltage when full, V.
    pub battery_full_v: f64,
    /// The on-board attitude loop as a PD law, whatever part of the setpoint is sent to it; `None`
    /// where it is the autopilot's own.
    pub attitude_pd: Option<AttitudePd>,
    /// Delay and lag between a setpoint and its effect.
    pub actuation: Actuation,
    /// The reference to fly.
    pub reference: Arc<dyn ReferenceSource + Send + Sync>,
    /// Time without any vehicle, from the start or from the last message, before the search ends,
    /// s; `None` waits for ever.
    pub search_timeout_s: Option<f64>,
}

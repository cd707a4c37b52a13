//! What the catalogue of effects does not have: disturbances from outside, and other laws than the
//! catalogue's for causes that it knows. Checks of a diagnosis are made with them.

mod active;

use serde::{Deserialize, Serialize};

pub(crate) use self::active::{Active, Scene};

/// A disturbance, or another law.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "snake_case")]
pub enum Foreign {
    /// A load that is part of the vehicle's mass but swings on a line. With w^2 = g / l,
    /// r'' = -(w^2 r + 2 c w r' + a), r its horizontal place under the vehicle and a the vehicle's
    /// horizontal acceleration; against a fixed load it adds the force m (w^2 r + a).
    SlungLoad {
        /// m, kg.
        mass_kg: f64,
        /// l, m.
        length_m: f64,
        /// c, the damping ratio.
        damping: f64,
    },
    /// A load that is added at the centre of mass: mass times 1 + share. What the rotors give is then
    /// spread over more; against the vehicle alone it adds the force -F share / (1 + share), F the
    /// rotors' force.
    Payload {
        /// Over the vehicle's mass; negative for a load that is dropped.
        share: f64,
    },
    /// A line to a place in the world that pulls like a spring where it is taut.
    Tether {
        /// North, east, down, m.
        anchor_m: [f64; 3],
        /// Length at which it begins to pull, m.
        slack_m: f64,
        /// N/m
        stiffness_n_m: f64,
    },
    /// A force in the world that swings, whatever the vehicle does.
    Periodic {
        /// North, east, down, N.
        force_n: [f64; 3],
        /// s
        period_s: f64,
    },
    /// A force in the world around a place, as of a fan: by exp(-(d / radius)^2) of the horizontal
    /// distance d.
    Jet {
        /// North, east, m.
        centre_m: [f64; 2],
        /// m
        radius_m: f64,
        /// North, east, down, N.
        force_n: [f64; 3],
    },
    /// Pushes in random directions at random times.
    Bumps {
        /// N
        force_n: f64,
        /// s
        duration_s: f64,
        /// Mean time between them, s.
        interval_s: f64,
    },
    /// One rotor loses thrust for moments at random times.
    ThrustBursts {
        /// Which.
        rotor: usize,
        /// Share that is lost.
        loss: f64,
        /// s
        duration_s: f64,
        /// Mean time between them, s.
        interval_s: f64,
    },
    /// A force to the right of the body that grows with the yaw rate.
    YawRateForce {
        /// N s/rad
        force_ns: f64,
    },
    /// Drag that grows with another power of the speed: F = -c |v|^(p - 1) v on the velocity
    /// relative to the air.
    DragPower {
        /// c, N / (m/s)^p.
        coefficient: f64,
        /// p
        exponent: f64,
    },
    /// Quadratic drag of a body that is not a sphere: F_i = -q_i |v| v_i, with a cross term that
    /// lifts it: F_z += -x |v_h|^2.
    DragBody {
        /// q along body front, right, down, N s^2/m^2.
        quadratic: [f64; 3],
        /// x, N s^2/m^2.
        cross: f64,
    },
    /// Drag of flat plates: each axis by its own component's square, F_i = -q_i |v_i| v_i.
    DragPlates {
        /// q along body front, right, down, N s^2/m^2.
        quadratic: [f64; 3],
    },
    /// Rotors that follow by two equal lags in a row.
    LagSecondOrder {
        /// Each, s.
        tau_s: f64,
    },
    /// Rotors that spin down more slowly than up.
    LagAsymmetric {
        /// s
        up_s: f64,
        /// s
        down_s: f64,
    },
    /// Thrust near the floor times 1 + gain exp(-h / length).
    GroundExponential {
        /// -
        gain: f64,
        /// m
        length_m: f64,
    },
    /// Each rotor near the floor for itself, by 1 / (1 - (c R / 4 h_i)^2) at its own height h_i
    /// (Cheeseman and Bennett 1955): a tilted vehicle is levelled.
    GroundPerRotor {
        /// c R: the radius of a rotor, with what four side by side gain, m.
        radius_m: f64,
    },
    /// Thrust that grows with the speed v across the rotors and saturates:
    /// times 1 + gain v^2 / (v^2 + speed^2).
    LiftSaturating {
        /// -
        gain: f64,
        /// m/s
        speed_m_s: f64,
    },
    /// A worn rotor: it loses thrust, and a smaller share of its drag torque.
    RotorWear {
        /// Which.
        rotor: usize,
        /// Share of the thrust that is lost.
        loss: f64,
        /// Share of the drag torque that is lost, over that of the thrust.
        torque_share: f64,
    },
    /// Drag torque that grows with another power of the rotor's speed, and differs by its spin:
    /// torque_i = (1 + by +- apart) (f_i / f_hover)^(power - 1) of the nominal.
    YawTorquePower {
        /// by
        by: f64,
        /// apart; plus where the spin is +1.
        apart: f64,
        /// power
        power: f64,
        /// Thrust of a rotor in hover, N.
        hover_n: f64,
    },
    /// Thrust times 1 - slope (1 - V / full): affine in the voltage inside the pack, behind a
    /// first-order lag.
    SagAffine {
        /// -
        slope: f64,
        /// s
        recovery_s: f64,
    },
    /// Thrust times (V / full)^exponent, V the terminal voltage behind a first-order lag: the pack
    /// recovers.
    SagRecovery {
        /// -
        exponent: f64,
        /// s
        recovery_s: f64,
    },
    /// Thrust by s + b (s^3 - s).
    CurveCubic {
        /// b
        b: f64,
    },
    /// Thrust by a dead zone and a power: ((s - dead) / (1 - dead))^power.
    CurvePower {
        /// -
        dead: f64,
        /// -
        power: f64,
    },
    /// Gusts of another spectrum than Dryden's: eddies of many lengths with energy by the length to
    /// 5/3 (Kolmogorov), carried past at a speed.
    GustEddies {
        /// Standard deviation per axis, m/s.
        sigma_m_s: f64,
        /// The longest eddy, m.
        length_m: f64,
        /// m/s
        speed_m_s: f64,
    },
    /// A payload on a rod below the rotors: the drag of the vehicle, which has its centre above the
    /// new centre of mass, turns it; M = z x F with F = -c v.
    PayloadLever {
        /// c, N s/m.
        drag_ns_m: f64,
        /// z: how far the centre of mass has sunk, m.
        sunk_m: f64,
    },
    /// Wind that grows with height by a power law: v (h / 3 m)^exponent.
    WindShear {
        /// North, east at 3 m, m/s.
        velocity_m_s: [f64; 2],
        /// -
        exponent: f64,
    },
}

impl Foreign {
    /// Its kind in files.
    pub fn name(&self) -> &'static str {
        match self {
            Self::SlungLoad { .. } => "slung_load",
            Self::Payload { .. } => "payload",
            Self::Tether { .. } => "tether",
            Self::Periodic { .. } => "periodic",
            Self::Jet { .. } => "jet",
            Self::Bumps { .. } => "bumps",
            Self::ThrustBursts { .. } => "thrust_bursts",
            Self::YawRateForce { .. } => "yaw_rate_force",
            Self::DragPower { .. } => "drag_power",
            Self::DragBody { .. } => "drag_body",
            Self::DragPlates { .. } => "drag_plates",
            Self::GroundPerRotor { .. } => "ground_per_rotor",
            Self::LiftSaturating { .. } => "lift_saturating",
            Self::RotorWear { .. } => "rotor_wear",
            Self::YawTorquePower { .. } => "yaw_torque_power",
            Self::SagAffine { .. } => "sag_affine",
            Self::CurvePower { .. } => "curve_power",
            Self::GustEddies { .. } => "gust_eddies",
            Self::PayloadLever { .. } => "payload_lever",
            Self::LagSecondOrder { .. } => "lag_second_order",
            Self::LagAsymmetric { .. } => "lag_asymmetric",
            Self::GroundExponential { .. } => "ground_exponential",
            Self::SagRecovery { .. } => "sag_recovery",
            Self::CurveCubic { .. } => "curve_cubic",
            Self::WindShear { .. } => "wind_shear",
        }
    }
}

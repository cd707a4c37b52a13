//! Effects outside the catalogue: external disturbances, and different laws for causes that the
//! catalogue has. They serve to test a diagnosis.

mod active;

use serde::{Deserialize, Serialize};

pub(crate) use self::active::{Active, Surroundings};

/// An external disturbance, or a law that differs from the catalogue's.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "snake_case")]
pub enum Foreign {
    /// A load that is part of the vehicle's mass and swings on a line. With w^2 = g / l, r'' =
    /// -(w^2 r + 2 c w r' + a), where r is its horizontal offset from the vehicle and a the
    /// vehicle's horizontal acceleration. Compared with a fixed load it adds the force m (w^2 r +
    /// a).
    SlungLoad {
        /// m, kg.
        mass_kg: f64,
        /// l, m.
        length_m: f64,
        /// c, the damping ratio.
        damping: f64,
    },
    /// A load at the centre of mass: the mass is multiplied by 1 + share. It acts as an added force
    /// -F share / (1 + share) on the unloaded vehicle, where F is the rotors' force.
    Payload {
        /// Load over the vehicle's mass; negative for a dropped load.
        share: f64,
    },
    /// A line to a fixed anchor that pulls like a spring when taut.
    Tether {
        /// Anchor north, east, down, m.
        anchor_m: [f64; 3],
        /// Length above which it pulls, m.
        slack_m: f64,
        /// Stiffness, N/m.
        stiffness_n_m: f64,
    },
    /// A sinusoidal force in world axes, independent of the vehicle.
    Periodic {
        /// North, east, down, N.
        force_n: [f64; 3],
        /// s
        period_s: f64,
    },
    /// A force in world axes around a place, as from a fan: it falls off as exp(-(d / radius)^2)
    /// with the horizontal distance d.
    Jet {
        /// Centre north, east, m.
        centre_m: [f64; 2],
        /// m
        radius_m: f64,
        /// North, east, down, N.
        force_n: [f64; 3],
    },
    /// Half-sine pushes in random directions at random times.
    Bumps {
        /// N
        force_n: f64,
        /// s
        duration_s: f64,
        /// Mean time from the end of one to the start of the next, s.
        interval_s: f64,
    },
    /// One rotor loses thrust briefly at random times.
    ThrustBursts {
        /// Index of the rotor, from 0.
        rotor: usize,
        /// Share of the thrust that is lost.
        loss: f64,
        /// s
        duration_s: f64,
        /// Mean time from the end of one to the start of the next, s.
        interval_s: f64,
    },
    /// A force to the right of the body, proportional to the yaw rate.
    YawRateForce {
        /// N s/rad
        force_ns: f64,
    },
    /// Drag with a different power of the speed: F = -c |v|^(p - 1) v, v the velocity relative to
    /// the air.
    DragPower {
        /// c, N / (m/s)^p.
        coefficient: f64,
        /// p
        exponent: f64,
    },
    /// Quadratic drag of a non-spherical body, F_i = -q_i |v| v_i, with a lifting cross term F_z +=
    /// -x |v_h|^2.
    DragBody {
        /// q along body front, right, down, N s^2/m^2.
        quadratic: [f64; 3],
        /// x, N s^2/m^2.
        cross: f64,
    },
    /// Drag of flat plates, where each axis depends on its own component: F_i = -q_i |v_i| v_i.
    DragPlates {
        /// q along body front, right, down, N s^2/m^2.
        quadratic: [f64; 3],
    },
    /// Rotors with two equal first-order lags in series.
    LagSecondOrder {
        /// Time constant of each lag, s.
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
    /// Ground effect for each rotor at its own height h_i, 1 / (1 - (c R / 4 h_i)^2) (Cheeseman and
    /// Bennett 1955). It levels a tilted vehicle.
    GroundPerRotor {
        /// c R: the radius of a rotor, times the gain of four side by side, m.
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
        /// Index of the rotor, from 0.
        rotor: usize,
        /// Share of the thrust that is lost.
        loss: f64,
        /// Lost share of the drag torque over the lost share of the thrust.
        torque_share: f64,
    },
    /// Drag torque with a different power of the rotor's thrust, and a difference between the
    /// spins: torque_i = (1 + by +- apart) (f_i / f_hover)^(power - 1) times the nominal.
    YawTorquePower {
        /// by
        by: f64,
        /// apart; added where the spin is +1, else subtracted.
        apart: f64,
        /// power
        power: f64,
        /// f_hover: thrust of a rotor in hover, N.
        hover_n: f64,
    },
    /// Thrust times 1 - slope (1 - V / full): affine in the terminal voltage V behind a first-order
    /// lag.
    SagAffine {
        /// -
        slope: f64,
        /// s
        recovery_s: f64,
    },
    /// Thrust times (V / full)^exponent, V the terminal voltage behind a first-order lag, like a
    /// pack that recovers slowly.
    SagRecovery {
        /// -
        exponent: f64,
        /// s
        recovery_s: f64,
    },
    /// Thrust as a cubic in the rotor's state: s + b (s^3 - s).
    CurveCubic {
        /// b
        b: f64,
    },
    /// Thrust with a dead zone and a power: ((s - dead) / (1 - dead))^power.
    CurvePower {
        /// -
        dead: f64,
        /// -
        power: f64,
    },
    /// Gusts with a different spectrum than Dryden's: eddies of many lengths with a spectral
    /// density as the length to 5/3 (Kolmogorov), carried past at a constant speed.
    GustEddies {
        /// Standard deviation along each axis, m/s.
        sigma_m_s: f64,
        /// The longest eddy, m.
        length_m: f64,
        /// m/s
        speed_m_s: f64,
    },
    /// A payload on a rod below the rotors. The vehicle's drag acts above the new centre of mass
    /// and exerts the moment M = z x F with F = -c v.
    PayloadLever {
        /// c, kg/s.
        drag_ns_m: f64,
        /// z: downward shift of the centre of mass, m.
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
    /// The value of `kind` in files.
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

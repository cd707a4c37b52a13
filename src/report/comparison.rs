//! Flights along one desired trajectory, side by side.

use schemars::JsonSchema;
use serde::Serialize;
use vehicle::frame::{Ned, wrap_angle};

use super::flight::{FlightReport, Row};
use crate::log::schema::{ControlMessage, ReferenceMessage};
use crate::plan::Trajectory;
use crate::plan::reference::ReferenceSource;

/// Components of `u_hat`.
const INPUTS: usize = 7;

/// What a flight did at one control tick along the trajectory.
#[derive(Clone, Copy, Debug)]
pub(super) struct Instant {
    /// Since the trajectory's start, s.
    pub time_s: f64,
    /// Relative to the trajectory's origin.
    pub desired: Ned,
    pub flown: Ned,
    /// Flown less desired.
    pub yaw_error_rad: f64,
    /// The reference's input less that of hover at the desired yaw, and the feedback.
    pub open_loop: [f64; INPUTS],
    pub feedback: [f64; INPUTS],
}

/// One flight against the desired trajectory, whatever its reference was.
#[derive(Clone, Debug)]
pub struct Track {
    pub(super) instants: Vec<Instant>,
}

/// Errors of one flight along the trajectory.
#[derive(Clone, Copy, Debug, PartialEq, JsonSchema, Serialize)]
pub struct TrackErrors {
    /// Root mean square of the position error, north, east, down, m.
    pub rmse_ned_m: [f64; 3],
    /// And of its length, m.
    pub rmse_3d_m: f64,
    /// Its greatest length, m.
    pub max_3d_m: f64,
    /// Root mean square of the yaw error, rad.
    pub rmse_yaw_rad: f64,
}

/// How much of the input each part gave.
#[derive(Clone, Copy, Debug, PartialEq, JsonSchema, Serialize)]
pub struct InputShare {
    /// Root mean square of the reference's input beyond that of hover at the desired yaw: thrust
    /// (N), roll, pitch, yaw (rad), body rates (rad/s).
    pub open_loop_rms: [f64; INPUTS],
    /// Root mean square of the feedback.
    pub feedback_rms: [f64; INPUTS],
    /// Feedback's share of the sum of both magnitudes, the mean over thrust, roll and pitch: what
    /// moves the vehicle.
    pub feedback_share: f64,
}

/// The flights of one controller.
#[derive(Clone, Debug, JsonSchema, Serialize)]
pub struct Contender {
    /// model-free, net, physics or hybrid; with the control law where laws are compared.
    pub name: String,
    /// Mean over the flights.
    pub mean: TrackErrors,
    /// Of the first flight.
    pub share: InputShare,
    /// Each flight.
    pub flights: Vec<TrackErrors>,
    #[serde(skip)]
    pub(super) first: Track,
}

fn flown(row: &Row) -> Ned {
    Ned::new(row.state.p_n_m, row.state.p_e_m, row.state.p_d_m)
}

impl Track {
    /// The part of a flight along `desired`. `reference` is what the flight followed: it tells
    /// where the trajectory's origin was.
    pub fn new(
        report: &FlightReport,
        desired: &Trajectory,
        reference: &dyn ReferenceSource,
        hover_thrust_n: f64,
    ) -> Self {
        let tracked = |row: &Row| -> Option<(f64, ReferenceMessage, ControlMessage)> {
            let followed = row.followed()?.clone();
            let time = followed.trajectory_time_s;
            time.is_finite().then_some((time, followed, row.share()?.clone()))
        };
        let mut origin = None;
        let instants = report.rows.iter().filter_map(|row| {
            let (time_s, followed, control) = tracked(row)?;
            let origin = *origin.get_or_insert_with(|| {
                let at = Ned::new(followed.p_n_m, followed.p_e_m, followed.p_d_m);
                at - reference.sample(time_s).position
            });
            let point = desired.sample(time_s);
            let c = &control;
            let yaw = wrap_angle(c.ff_yaw_rad - point.yaw);
            Some(Instant {
                time_s,
                desired: point.position,
                flown: flown(row) - origin,
                yaw_error_rad: wrap_angle(row.state.yaw_rad - point.yaw),
                open_loop: [
                    c.ff_thrust_n - hover_thrust_n,
                    c.ff_roll_rad,
                    c.ff_pitch_rad,
                    yaw,
                    c.ff_p_radps,
                    c.ff_q_radps,
                    c.ff_r_radps,
                ],
                feedback: [
                    c.fb_thrust_n,
                    c.fb_roll_rad,
                    c.fb_pitch_rad,
                    c.fb_yaw_rad,
                    c.fb_p_radps,
                    c.fb_q_radps,
                    c.fb_r_radps,
                ],
            })
        });
        Self { instants: instants.collect() }
    }

    /// Whether the trajectory was followed at all.
    pub fn is_empty(&self) -> bool {
        self.instants.is_empty()
    }

    fn mean(&self, of: impl Fn(&Instant) -> f64) -> f64 {
        self.instants.iter().map(of).sum::<f64>() / self.instants.len() as f64
    }

    /// The errors.
    pub fn errors(&self) -> TrackErrors {
        let error = |i: &Instant| i.flown - i.desired;
        let axis = |axis: usize| self.mean(|i| error(i).to_array()[axis].powi(2)).sqrt();
        TrackErrors {
            rmse_ned_m: [axis(0), axis(1), axis(2)],
            rmse_3d_m: self.mean(|i| error(i).dot(error(i))).sqrt(),
            max_3d_m: self.instants.iter().map(|i| error(i).norm()).fold(0.0, f64::max),
            rmse_yaw_rad: self.mean(|i| i.yaw_error_rad.powi(2)).sqrt(),
        }
    }

    /// The parts of the input.
    pub fn share(&self) -> InputShare {
        let rms = |of: fn(&Instant) -> &[f64; INPUTS]| {
            std::array::from_fn(|i| self.mean(|instant| of(instant)[i].powi(2)).sqrt())
        };
        let shares = (0..3).map(|i| {
            let feedback = self.mean(|instant| instant.feedback[i].abs());
            let open_loop = self.mean(|instant| instant.open_loop[i].abs());
            feedback / (feedback + open_loop).max(f64::MIN_POSITIVE)
        });
        InputShare {
            open_loop_rms: rms(|instant| &instant.open_loop),
            feedback_rms: rms(|instant| &instant.feedback),
            feedback_share: shares.sum::<f64>() / 3.0,
        }
    }
}

impl Contender {
    /// The flights of one controller; nothing where there are none.
    pub fn new(name: &str, tracks: Vec<Track>) -> Option<Self> {
        let flights: Vec<TrackErrors> = tracks.iter().map(Track::errors).collect();
        let first = tracks.into_iter().next()?;
        let mean = |of: &dyn Fn(&TrackErrors) -> f64| {
            flights.iter().map(of).sum::<f64>() / flights.len() as f64
        };
        let mean = TrackErrors {
            rmse_ned_m: [0, 1, 2].map(|axis| mean(&|e| e.rmse_ned_m[axis])),
            rmse_3d_m: mean(&|e| e.rmse_3d_m),
            max_3d_m: mean(&|e| e.max_3d_m),
            rmse_yaw_rad: mean(&|e| e.rmse_yaw_rad),
        };
        Some(Self { name: name.to_owned(), mean, share: first.share(), flights, first })
    }
}

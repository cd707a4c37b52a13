//! The vehicle's speed of response to its setpoints, compared with the file's loop and inertia.

use std::ops::Range;

use vehicle::frame::{Attitude, Frd, wrap_angle};
use vehicle::{AttitudeCascade, AttitudePd, VehicleParams};

use super::{Held, Verdict, blocks, brief};
use crate::learn::alignment::interpolated;
use crate::log::import::{AttitudeSetpoint, Flight, SetpointSource};

/// Step of the predicted response, s.
const FINE_S: f64 = 1e-3;
/// Length of the predicted response, s: the slowest loop comes to rest within it.
const LENGTH_S: f64 = 12.0;
/// Step at which the log is sampled, s.
const STEP_S: f64 = 0.02;
/// Longest memory of a setpoint, s.
const MEMORY_S: f64 = 3.0;
/// Least and greatest time scale of the response that are tried, relative to the prediction, and
/// the number of scales.
const SCALES: [f64; 2] = [0.25, 4.0];
const SCALES_TRIED: usize = 49;
/// Age above which a setpoint is missing, s: autopilots log theirs at 10 Hz and more.
const SETPOINT_AGE_MAX_S: f64 = 0.3;
/// Share by which the time may differ: a file does not contain all of an autopilot's filters and
/// delays.
const TOLERANCE: f64 = 0.25;
/// Accuracy of the delay of setpoints from the ground, s: it is mostly an estimate in a vehicle
/// file.
const DELAY_KNOWN_S: f64 = 0.05;
/// Root mean square of the setpoint's motion required to show a loop, rad.
const MOVES_MIN: [f64; 3] = [0.026, 0.026, 0.052];
/// Share of the motion that the response must explain.
const EXPLAINED_MIN: f64 = 0.5;
/// Fewest blocks that show the chance variation.
const BLOCKS_MIN: usize = 3;
/// Share of a setpoint's step that counts as followed.
const FOLLOWED: f64 = 0.632;
/// Names of the axes.
const AXES: [&str; 3] = ["roll", "pitch", "yaw"];

/// The loop of a vehicle file about one axis, near hover.
#[derive(Clone, Copy)]
enum Loop<'a> {
    Pd(&'a AttitudePd),
    Cascade(&'a AttitudeCascade),
}

/// The angle's responses about one axis, every [`FINE_S`].
struct Answer {
    /// To a unit step of the desired angle.
    attitude: Vec<f64>,
    /// To a unit impulse of the desired rate: 1/s times s.
    rate: Vec<f64>,
}

impl Answer {
    /// `is_shaped` means that the log's setpoints are the autopilot's own, after shaping, as in
    /// ArduCopter's log. The loop follows them without shaping them again, and feeds their rate
    /// forward.
    fn of(vehicle: &VehicleParams, axis: usize, is_shaped: bool) -> Option<Self> {
        let unshaped = vehicle
            .attitude_cascade
            .filter(|_| is_shaped)
            .map(|cascade| AttitudeCascade { input_time_constant_s: None, ..cascade });
        let law = match (&vehicle.attitude_pd, &unshaped, &vehicle.attitude_cascade) {
            (Some(pd), _, _) => Loop::Pd(pd),
            (None, Some(cascade), _) | (None, None, Some(cascade)) => Loop::Cascade(cascade),
            (None, None, None) => return None,
        };
        let mut attitude = simulated(law, vehicle, axis, 1.0, 0.0);
        // The impulse response to the rate, from the differences of the step response.
        let ramp = simulated(law, vehicle, axis, 0.0, 1.0);
        let rate: Vec<f64> = ramp.windows(2).map(|pair| (pair[1] - pair[0]) / FINE_S).collect();
        if unshaped.is_some() {
            // The rate of an angle step is an impulse.
            attitude.iter_mut().zip(&rate).for_each(|(angle, forward)| *angle += forward);
        }
        attitude.iter().all(|angle| angle.is_finite()).then_some(Self { attitude, rate })
    }

    /// Time until a step is followed, s.
    fn followed_s(&self) -> Option<f64> {
        let at = self.attitude.iter().position(|angle| *angle >= FOLLOWED)?;
        Some(at as f64 * FINE_S)
    }

    fn at(values: &[f64], time: f64) -> f64 {
        let index = ((time / FINE_S) as usize).min(values.len().saturating_sub(1));
        values.get(index).copied().unwrap_or_default()
    }
}

/// The angle under constant desired angle and rate, from rest: rigid body, first-order rotors, the
/// loop without its saturation of rate and torque.
fn simulated(law: Loop, vehicle: &VehicleParams, axis: usize, angle: f64, rate: f64) -> Vec<f64> {
    let inertia = vehicle.inertia[axis];
    let damping = vehicle.angular_damping_nms.map_or(0.0, |nms| nms[axis]);
    let lag = vehicle.motor_time_constant_s.max(FINE_S);
    let [mut theta, mut omega, mut moment] = [0.0_f64; 3];
    let [mut shaped, mut seen, mut slope, mut integral] = [0.0_f64; 4];
    (0..(LENGTH_S / FINE_S) as usize)
        .map(|_| {
            let now = theta;
            let moment_target = match law {
                Loop::Pd(pd) => pd.kp[axis] * (angle - theta) + pd.kd[axis] * (rate - omega),
                Loop::Cascade(cascade) => {
                    let time_constant = cascade.input_time_constant_s.filter(|tc| *tc > 0.0);
                    let forward = time_constant.map_or(0.0, |tc| (angle - shaped) / tc);
                    shaped = time_constant.map_or(angle, |_| shaped + FINE_S * forward);
                    let desired = cascade.angle_p_per_s[axis] * (shaped - theta) + forward + rate;
                    let filter = |cutoff_hz: f64| {
                        let step = std::f64::consts::TAU * cutoff_hz * FINE_S;
                        step / (1.0 + step)
                    };
                    let before = seen;
                    seen += filter(cascade.gyro_cutoff_hz) * (omega - seen);
                    let turning = (seen - before) / FINE_S;
                    slope += filter(cascade.derivative_cutoff_hz) * (turning - slope);
                    let error = desired - seen;
                    let most = cascade.integral_max_nm[axis];
                    integral =
                        (integral + FINE_S * cascade.rate_i_nm[axis] * error).clamp(-most, most);
                    cascade.rate_p_nms[axis] * error + integral - cascade.rate_d_nms2[axis] * slope
                        + cascade.rate_ff_nms[axis] * desired
                }
            };
            moment += FINE_S / lag * (moment_target - moment);
            omega += FINE_S / inertia * (moment - damping * omega);
            theta += FINE_S * omega;
            now
        })
        .collect()
}

/// Desired and flown angle about one axis, every [`STEP_S`] of one span.
struct Track {
    start: f64,
    setpoints: Vec<f64>,
    setpoint_rates: Vec<f64>,
    flown: Vec<f64>,
}

/// Compares each axis, one sentence for each; empty where the file has no loop.
pub(super) fn held(flight: &Flight, spans: &[Range<f64>], vehicle: &VehicleParams) -> Vec<Held> {
    let (delay, known) = match flight.setpoint_source {
        SetpointSource::Ground => (vehicle.command_delay_s, DELAY_KNOWN_S),
        SetpointSource::Onboard => (0.0, 0.0),
    };
    let takes_rates = vehicle.attitude_pd.is_some();
    let shapes = vehicle
        .attitude_cascade
        .is_some_and(|cascade| cascade.input_time_constant_s.is_some_and(|time_s| time_s > 0.0));
    let is_shaped = shapes && flight.setpoint_source == SetpointSource::Onboard;
    (0..3)
        .filter_map(|axis| {
            let answer = Answer::of(vehicle, axis, is_shaped)?;
            let of = |span| tracks(flight, span, axis, delay, takes_rates);
            let tracks: Vec<Track> = spans.iter().flat_map(of).collect();
            Some(of_axis(axis, &answer, &tracks, (delay, known), vehicle))
        })
        .collect()
}

fn of_axis(
    axis: usize,
    answer: &Answer,
    tracks: &[Track],
    (delay, known): (f64, f64),
    vehicle: &VehicleParams,
) -> Held {
    let name = AXES[axis];
    let field = if vehicle.attitude_pd.is_some() { "attitude_pd" } else { "attitude_cascade" };
    let held = Held {
        check: name,
        field,
        verdict: Verdict::NotShown,
        expected: 0.0,
        found: None,
        half_width: None,
        unit: "s",
        what: String::new(),
    };
    let Some(predicted) = answer.followed_s() else {
        let what = format!(
            "{name}: with the file's {field} and inertia the vehicle never follows a setpoint"
        );
        return Held { verdict: Verdict::Differs, what, ..held };
    };
    let held = Held { expected: predicted + delay, ..held };
    let not_shown =
        |what: String| Held { what: format!("{name}: not shown: {what}"), ..held.clone() };
    let moves = moves(tracks);
    if moves.is_none_or(|moves| moves < MOVES_MIN[axis]) {
        return not_shown(format!(
            "the setpoints move by {} deg, expected at least {} deg",
            brief(moves.unwrap_or(0.0).to_degrees()),
            brief(MOVES_MIN[axis].to_degrees())
        ));
    }
    let costs: Vec<Costs> = (0..SCALES_TRIED)
        .map(|k| {
            let share = k as f64 / (SCALES_TRIED - 1) as f64;
            let scale = SCALES[0] * (SCALES[1] / SCALES[0]).powf(share);
            Costs::at(scale, answer, tracks)
        })
        .collect();
    let count = costs.first().map_or(0, |costs| costs.left.len());
    if count < BLOCKS_MIN {
        return not_shown(format!("expected at least {BLOCKS_MIN} blocks of 4 s, found {count}"));
    }
    let (best, left) = least(&costs, None);
    let power: f64 = costs.first().map_or(0.0, |costs| costs.power.iter().sum());
    let explained = 1.0 - left / power;
    if explained < EXPLAINED_MIN {
        return Held {
            verdict: Verdict::NotShown,
            what: format!(
                "{name}: not shown: no loop of the file's kind explains how the vehicle follows \
                 its setpoints ({} % of it, expected at least {} %)",
                brief(100.0 * explained.max(0.0)),
                100.0 * EXPLAINED_MIN
            ),
            ..held
        };
    }
    // Jackknife over blocks, of the logarithm of the scale.
    let without: Vec<f64> = (0..count).map(|block| least(&costs, Some(block)).0.ln()).collect();
    let n = count as f64;
    let mean = without.iter().sum::<f64>() / n;
    let spread: f64 = without.iter().map(|log| (log - mean).powi(2)).sum();
    let half = 2.0 * (spread * (n - 1.0) / n).sqrt();
    let found = delay + best * predicted;
    let [low, high] = [(-half).exp(), half.exp()].map(|share| delay + share * best * predicted);
    let quickest = delay + predicted / (1.0 + TOLERANCE) - known;
    let slowest = delay + predicted * (1.0 + TOLERANCE) + known;
    let differs = high < quickest || low > slowest;
    let strength = if axis == 2 { "drag torque" } else { "thrust" };
    let advice = if differs {
        format!(": {field}, inertia or the rotors' {strength} do not match this vehicle")
    } else {
        String::new()
    };
    Held {
        verdict: if differs { Verdict::Differs } else { Verdict::Fits },
        found: Some(found),
        half_width: Some(0.5 * (high - low)),
        what: format!(
            "{name}: the vehicle turns by 63 % of a setpoint's step within {} s ({} to {}), \
             expected {} s from {field} and inertia{advice}",
            brief(found),
            brief(low),
            brief(high),
            brief(predicted + delay)
        ),
        ..held
    }
}

/// Root mean square of the setpoints' motion about their means.
fn moves(tracks: &[Track]) -> Option<f64> {
    let count: usize = tracks.iter().map(|track| track.setpoints.len()).sum();
    let power: f64 = tracks.iter().map(|track| about_mean(&track.setpoints)).sum();
    (count > 0).then(|| (power / count as f64).sqrt())
}

/// Sum of squares about the mean.
fn about_mean(values: &[f64]) -> f64 {
    let mean = values.iter().sum::<f64>() / values.len() as f64;
    values.iter().map(|value| (value - mean).powi(2)).sum()
}

/// Residuals of the response at one time scale, by block.
struct Costs {
    scale: f64,
    left: Vec<f64>,
    power: Vec<f64>,
}

impl Costs {
    /// The residuals of the file's response S stretched in time by `scale`: theta is the desired
    /// angle convolved with the steps of S(t/scale).
    fn at(scale: f64, answer: &Answer, tracks: &[Track]) -> Self {
        let taps = (MEMORY_S / STEP_S) as usize;
        let step = |k: usize| Answer::at(&answer.attitude, k as f64 * STEP_S / scale);
        // The response beyond the memory goes to the last tap, so a steady setpoint keeps its full
        // response.
        let mut kernel: Vec<f64> = (0..taps).map(|k| step(k + 1) - step(k)).collect();
        let rest = 1.0 - kernel.iter().sum::<f64>();
        if let Some(last) = kernel.last_mut() {
            *last += rest;
        }
        let by_rate: Vec<f64> = (0..taps)
            .map(|k| Answer::at(&answer.rate, (k as f64 + 0.5) * STEP_S / scale) * STEP_S)
            .collect();
        let mut costs = Self { scale, left: Vec::new(), power: Vec::new() };
        for track in tracks {
            let predicted = track.predicted(&kernel, &by_rate);
            let errors: Vec<f64> = track.flown.iter().zip(&predicted).map(|(a, b)| a - b).collect();
            let end = track.start + track.flown.len() as f64 * STEP_S;
            for block in blocks(std::slice::from_ref(&(track.start..end))) {
                let at = |time: f64| ((time - track.start) / STEP_S).round() as usize;
                let range = at(block.start)..at(block.end).min(errors.len());
                costs.left.push(about_mean(&errors[range.clone()]));
                costs.power.push(about_mean(&track.flown[range]));
            }
        }
        costs
    }
}

/// The scale with the least residual, without one of the blocks, and that residual.
fn least(costs: &[Costs], without: Option<usize>) -> (f64, f64) {
    let sum = |costs: &Costs| -> f64 {
        let kept = costs.left.iter().enumerate().filter(|(block, _)| Some(*block) != without);
        kept.map(|(_, left)| left).sum()
    };
    let sums: Vec<f64> = costs.iter().map(sum).collect();
    let best = (0..sums.len()).min_by(|a, b| sums[*a].total_cmp(&sums[*b])).unwrap_or(0);
    let log = |k: usize| costs[k].scale.ln();
    if best == 0 || best + 1 >= sums.len() {
        return (costs[best].scale, sums[best]);
    }
    // The parabola through the minimum and its neighbours.
    let [before, at, after] = [sums[best - 1], sums[best], sums[best + 1]];
    let bend = before - 2.0 * at + after;
    let shift = if bend > 0.0 { (0.5 * (before - after) / bend).clamp(-0.5, 0.5) } else { 0.0 };
    ((log(best) + shift * (log(best + 1) - log(best))).exp(), at)
}

impl Track {
    fn predicted(&self, kernel: &[f64], by_rate: &[f64]) -> Vec<f64> {
        let before = |values: &[f64], at: usize, k: usize| values[at.saturating_sub(k)];
        (0..self.setpoints.len())
            .map(|at| {
                let attitude: f64 = kernel
                    .iter()
                    .enumerate()
                    .map(|(k, h)| h * before(&self.setpoints, at, k + 1))
                    .sum();
                if self.setpoint_rates.is_empty() {
                    return attitude;
                }
                let rate = by_rate.iter().enumerate();
                attitude
                    + rate.map(|(k, h)| h * before(&self.setpoint_rates, at, k + 1)).sum::<f64>()
            })
            .collect()
    }
}

/// Desired and flown angle about `axis` in `span`, in pieces where the log has the attitude and a
/// setpoint no older than [`SETPOINT_AGE_MAX_S`].
fn tracks(
    flight: &Flight,
    span: &Range<f64>,
    axis: usize,
    delay: f64,
    takes_rates: bool,
) -> Vec<Track> {
    let at = |time: f64| -> Option<(&AttitudeSetpoint, Attitude, Attitude)> {
        let index = flight.setpoint.index_at(time - delay)?;
        let age = time - delay - flight.setpoint.times().get(index)?;
        let setpoint = flight.setpoint.values().get(index).filter(|_| age < SETPOINT_AGE_MAX_S)?;
        Some((setpoint, setpoint.attitude?, interpolated(&flight.attitude, time)?))
    };
    let mut pieces: Vec<Track> = Vec::new();
    let mut continues = false;
    for k in 0..((span.end - span.start) / STEP_S) as usize {
        let time = span.start + k as f64 * STEP_S;
        let Some((setpoint, attitude, flown)) = at(time) else {
            continues = false;
            continue;
        };
        if !continues {
            pieces.push(Track {
                start: time,
                setpoints: vec![],
                setpoint_rates: vec![],
                flown: vec![],
            });
            continues = true;
        }
        let Some(piece) = pieces.last_mut() else { continue };
        let heading = flown.yaw();
        let angle = |attitude: Attitude, turn: Option<&f64>| match axis {
            // The direction of the thrust relative to the vehicle's own heading.
            0 | 1 => tilted(attitude, heading)[axis],
            _ => turn.map_or(attitude.yaw(), |turn| turn + wrap_angle(attitude.yaw() - turn)),
        };
        let (desired, flown) =
            (angle(attitude, piece.setpoints.last()), angle(flown, piece.flown.last()));
        piece.setpoints.push(desired);
        piece.flown.push(flown);
        if let Some(rate) = setpoint.body_rate.filter(|_| takes_rates) {
            piece.setpoint_rates.push(rate.to_array()[axis]);
        }
    }
    for piece in &mut pieces {
        if piece.setpoint_rates.len() != piece.setpoints.len() {
            piece.setpoint_rates.clear();
        }
    }
    pieces
}

/// Roll and pitch of an attitude's thrust direction, relative to a heading.
fn tilted(attitude: Attitude, heading: f64) -> [f64; 2] {
    let [north, east, down] = attitude.to_world(Frd::new(0.0, 0.0, 1.0)).to_array();
    let (sin, cos) = heading.sin_cos();
    let (along, across) = (north * cos + east * sin, east * cos - north * sin);
    [(-across).clamp(-1.0, 1.0).asin(), along.atan2(down)]
}

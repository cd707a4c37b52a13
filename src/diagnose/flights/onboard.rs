//! The vehicle's own attitude loop, applied to logged setpoints.

use sitl::autopilot::offboard::{AttitudeSetpoint as OnboardSetpoint, JITTER_MEAN_S};
use sitl::autopilot::pd::AttitudeLoop;
use vehicle::effects::PdGain;
use vehicle::frame::Frd;
use vehicle::rotor::Allocation;
use vehicle::{AttitudePd, VehicleParams};

use crate::diagnose::flights::preparation::PreparedFlight;
use crate::diagnose::flights::series::median;
use crate::diagnose::flights::setpoints::as_onboard;
use crate::learn::commands::SETPOINT_AGE_MAX;
use crate::log::import::{AttitudeSetpoint, Stream};

/// Age above which a setpoint is stale, s.
pub const AGE_MAX_S: f64 = SETPOINT_AGE_MAX;
/// Stamps are whole microseconds: a time this close to a tick is at the tick, s.
pub(in crate::diagnose) const TICK_TOLERANCE_S: f64 = 1e-6;
/// One order of reports is better if the ratio of the outputs' unexplained changes is below this.
const ORDER_RATIO_MAX: f64 = 0.8;
/// As above, for the ratio of the medians.
const ORDER_MEDIAN_RATIO_MAX: f64 = 0.9;
/// Older setpoints whose arrival may still be pending at a tick.
const UNDER_WAY: usize = 3;
/// Probability that is ignored.
const NEGLIGIBLE: f64 = 1e-3;

/// The on-board law and the mixer that the vehicle file states.
#[derive(Clone, Debug)]
pub struct OnboardLaw {
    pd: AttitudePd,
    allocation: Allocation,
    /// Whether outputs stamped at a tick are those of the tick before: vehicles report either
    /// before or after the loop.
    reports_first: bool,
}

/// Timing of the inputs of a law.
#[derive(Clone, Copy, Debug)]
pub struct Timing {
    /// Delay from sending a setpoint to its use, s.
    pub command_delay: f64,
    /// Latency of the logged attitude behind the one used on board, s.
    pub latency: f64,
}

impl OnboardLaw {
    /// The law of a vehicle whose file states it.
    pub fn new(vehicle: &VehicleParams) -> Option<Self> {
        let (pd, allocation) = (vehicle.attitude_pd?, vehicle.allocation().ok()?);
        Some(Self { pd, allocation, reports_first: false })
    }

    /// The mixer of the firmware.
    pub fn allocation(&self) -> &Allocation {
        &self.allocation
    }

    /// The law with the report order of `flights`: before the loop or after it, whichever better
    /// explains the changes of the outputs. `timing` returns the timing for each order, since an
    /// unknown delay may look like the tick between the two.
    pub fn observing(self, flights: &[PreparedFlight], timing: impl Fn(&Self) -> Timing) -> Self {
        let reports_first = Self { reports_first: true, ..self.clone() };
        let changes = |law: &Self| -> Vec<f64> {
            let timing = timing(law);
            flights.iter().flat_map(|flight| law.changes(flight, timing)).collect()
        };
        let [first, later] = [changes(&reports_first), changes(&self)];
        let sums = [&first, &later].map(|changes| changes.iter().sum::<f64>());
        // Jumps decide where setpoints are infrequent. Where neither order explains the jumps, they
        // came from lost or late setpoints, and the changes between them decide. Where those do not
        // either, the output at a stamp is the one in force then, from the tick before.
        let is_first = if sums[0] < ORDER_RATIO_MAX * sums[1] {
            true
        } else if sums[1] < ORDER_RATIO_MAX * sums[0] {
            false
        } else {
            median(later) > ORDER_MEDIAN_RATIO_MAX * median(first)
        };
        if is_first { reports_first } else { self }
    }

    /// Squared changes from one output to the next that the law does not explain, as moments.
    fn changes(&self, flight: &PreparedFlight, timing: Timing) -> Vec<f64> {
        let law = self.with_gains(None);
        let (times, values) = (flight.outputs.times(), flight.outputs.values());
        let mut last: Option<[f64; 4]> = None;
        let mut changes = Vec::with_capacity(times.len());
        for (time, logged) in times.iter().zip(values) {
            if !flight.spans.iter().any(|span| span.contains(time)) {
                continue;
            }
            let by_law = self.outputs(&law, flight, self.tick_of_report(*time), timing);
            let left = by_law.map(|by_law| {
                self.allocation.wrench(std::array::from_fn(|i| logged[i] - by_law[i]))
            });
            if let Some((left, last)) = left.zip(last) {
                changes.push((1..4).map(|i| (left[i] - last[i]).powi(2)).sum());
            }
            last = left;
        }
        changes
    }

    /// Time of the loop's latest tick at `time`.
    pub fn tick(&self, time: f64) -> f64 {
        ((time + TICK_TOLERANCE_S) * self.pd.rate_hz).floor() / self.pd.rate_hz
    }

    /// Time of the tick whose outputs are reported at `time`.
    pub fn tick_of_report(&self, time: f64) -> f64 {
        if self.reports_first { self.tick(time - 2.0 * TICK_TOLERANCE_S) } else { self.tick(time) }
    }

    /// Whether outputs are reported before the loop's tick at the same time.
    pub fn reports_first(&self) -> bool {
        self.reports_first
    }

    /// The loop with its gains scaled by `gains`.
    pub fn with_gains(&self, gains: Option<PdGain>) -> AttitudeLoop {
        AttitudeLoop::new(gains.map_or(self.pd, |gains| gains.apply(&self.pd)), self.allocation)
    }

    /// The outputs of `law` at the tick `tick` of a flight, averaged over the link's jitter; `None`
    /// where no setpoint is in force.
    pub fn outputs(
        &self,
        law: &AttitudeLoop,
        flight: &PreparedFlight,
        tick: f64,
        timing: Timing,
    ) -> Option<[f64; 4]> {
        let reported = flight.attitude.attitude_at(tick + timing.latency).euler();
        let rate = Frd::from(flight.body_rate.at(tick));
        let constant = (timing.command_delay - JITTER_MEAN_S).max(0.0);
        let setpoints = &flight.setpoint;
        let newest = setpoints.index_at(tick - constant)?;
        let mut outputs = [0.0; 4];
        // Probability that none of the newer setpoints has arrived.
        let mut none_yet = 1.0;
        for index in (newest.saturating_sub(UNDER_WAY)..=newest).rev() {
            let under_way = tick - constant - setpoints.times()[index];
            let arrived = 1.0 - (-under_way / JITTER_MEAN_S).exp();
            let share = none_yet * arrived;
            if share > NEGLIGIBLE {
                let setpoint = flight
                    .onboard_setpoint(index)
                    .filter(|_| is_in_force(setpoints, index, tick))?;
                let by_law = law.outputs(&setpoint, reported, rate);
                outputs.iter_mut().zip(by_law).for_each(|(sum, u)| *sum += share * u);
            }
            none_yet -= share;
            if none_yet < NEGLIGIBLE {
                break;
            }
        }
        // The log's first setpoint may not have arrived yet.
        let arrived = 1.0 - none_yet;
        (arrived > NEGLIGIBLE).then(|| outputs.map(|u| u / arrived))
    }
}

/// Whether the setpoint with this index is not stale at `time`.
fn is_in_force(setpoints: &Stream<AttitudeSetpoint>, index: usize, time: f64) -> bool {
    time - setpoints.times()[index] <= AGE_MAX_S
}

/// The newest setpoint sent by `sent`, if it is not stale then.
pub fn setpoint_at(setpoints: &Stream<AttitudeSetpoint>, sent: f64) -> Option<OnboardSetpoint> {
    let index = setpoints.index_at(sent).filter(|index| is_in_force(setpoints, *index, sent))?;
    as_onboard(&setpoints.values()[index])
}

//! The vehicle's own attitude loop: what it makes of logged setpoints.

use sitl::autopilot::offboard::AttitudeSetpoint as OnboardSetpoint;
use sitl::autopilot::pd::AttitudeLoop;
use sitl::effects::PdGain;
use sitl::frame::{Attitude, Frd};
use sitl::rotor::Allocation;
use sitl::vehicle::{AttitudePd, VehicleParams};

use super::preparation::{PreparedFlight, Series};

/// A setpoint older than this no longer rules, s.
const AGE_MAX_S: f64 = 0.1;
/// Delays that are tried, s.
const DELAY_STEP_S: f64 = 0.001;
const DELAYS: usize = 80;
/// A delay that leaves at most so much more than the best is as good.
const AS_GOOD: f64 = 1.15;
/// Mean of the link's jitter, s: the exponential part of a delay of at least that.
const JITTER_MEAN_S: f64 = 0.001;
/// Setpoints whose arrival may still be awaited at a tick.
const UNDER_WAY: usize = 3;
/// The law explains the logged outputs if it leaves less than this share of their variance.
const UNEXPLAINED_MAX: f64 = 0.25;

/// The law with its mixer, as the vehicle file states them.
#[derive(Clone, Debug)]
pub struct OnboardLaw {
    command_delay: f64,
    pd: AttitudePd,
    allocation: Allocation,
}

/// When a law's command was given and what it sees then.
#[derive(Clone, Copy, Debug)]
pub struct Timing {
    /// From sending a setpoint to its use, s.
    pub command_delay: f64,
    /// How late the logged attitude is against what is used on board, s.
    pub latency: f64,
}

impl OnboardLaw {
    /// The law of a vehicle that states it.
    pub fn new(vehicle: &VehicleParams) -> Option<Self> {
        Some(Self {
            command_delay: vehicle.command_delay_s,
            pd: vehicle.attitude_pd?,
            allocation: vehicle.allocation().ok()?,
        })
    }

    /// Rate of the loop, Hz.
    pub fn rate_hz(&self) -> f64 {
        self.pd.rate_hz
    }

    /// The firmware's mixer.
    pub fn allocation(&self) -> &Allocation {
        &self.allocation
    }

    /// Time of the loop's latest tick at `time`.
    pub fn tick(&self, time: f64) -> f64 {
        ((time + 1e-6) * self.pd.rate_hz).floor() / self.pd.rate_hz
    }

    /// The loop with its gains scaled.
    pub fn with_gains(&self, gains: Option<PdGain>) -> AttitudeLoop {
        AttitudeLoop::new(gains.map_or(self.pd, |gains| gains.apply(&self.pd)), self.allocation)
    }

    /// What `law` gives at the tick `tick` of a flight, on average over the link's jitter; `None`
    /// where no setpoint rules.
    pub fn outputs(
        &self,
        law: &AttitudeLoop,
        flight: &PreparedFlight,
        tick: f64,
        timing: Timing,
    ) -> Option<[f64; 4]> {
        let [w, x, y, z] = flight.attitude.at(tick + timing.latency);
        let reported = Attitude { w, x, y, z }.normalized().euler();
        let rate = Frd::from(flight.body_rate.at(tick));
        let constant = (timing.command_delay - JITTER_MEAN_S).max(0.0);
        let newest = flight.setpoint.index_at(tick - constant)?;
        let mut outputs = [0.0; 4];
        // Probability that none of the newer setpoints has arrived.
        let mut none_yet = 1.0;
        for index in (newest.saturating_sub(UNDER_WAY)..=newest).rev() {
            let under_way = tick - constant - flight.setpoint.times()[index];
            let arrived = 1.0 - (-under_way / JITTER_MEAN_S).exp();
            let share = none_yet * arrived;
            if share > 1e-3 {
                let asked = setpoint(flight, index, tick)?;
                let by_law = law.outputs(&asked, reported, rate);
                outputs.iter_mut().zip(by_law).for_each(|(sum, u)| *sum += share * u);
            }
            none_yet -= share;
            if none_yet < 1e-3 {
                break;
            }
        }
        Some(outputs.map(|u| u / (1.0 - none_yet)))
    }

    /// Outputs of every tick: the law's, corrected by what the logged ones say it is off. Each
    /// stands at the middle of the time for which it is held.
    pub fn every_tick(&self, flight: &PreparedFlight) -> Option<Series<4>> {
        let law = self.with_gains(None);
        let logged = &flight.logged_outputs;
        let (first, last) = (*logged.times().first()?, *logged.times().last()?);
        let tried: Vec<(f64, f64)> = (0..DELAYS)
            .filter_map(|step| {
                let command_delay = self.command_delay + (step as f64 - 10.0) * DELAY_STEP_S;
                let timing = Timing { command_delay, latency: 0.0 };
                Some((self.unexplained(&law, flight, timing)?, command_delay))
            })
            .filter(|(_, delay)| *delay >= 0.0)
            .collect();
        let least = tried.iter().map(|(unexplained, _)| *unexplained).fold(f64::INFINITY, f64::min);
        // Setpoints and logged outputs may keep step, so that many delays do as well.
        let off = |delay: f64| (delay - self.command_delay).abs();
        let (unexplained, command_delay) = tried
            .into_iter()
            .filter(|(unexplained, _)| *unexplained <= AS_GOOD * least)
            .min_by(|a, b| off(a.1).total_cmp(&off(b.1)))?;
        if unexplained > UNEXPLAINED_MAX {
            return None;
        }
        let timing = Timing { command_delay, latency: 0.0 };
        // How far the law is off at the ticks that were logged.
        let (mut times, mut misses) = (Vec::new(), Vec::new());
        for (time, u) in logged.times().iter().zip(logged.values()) {
            let tick = self.tick(*time);
            if times.last().is_some_and(|last| tick <= *last) {
                continue;
            }
            if let Some(by_law) = self.outputs(&law, flight, tick, timing) {
                times.push(tick);
                misses.push(std::array::from_fn(|i| u[i] - by_law[i]));
            }
        }
        let misses = Series::from_parts(times, misses);
        let mut cursor = misses.cursor();
        let period = 1.0 / self.pd.rate_hz;
        let count = ((last - first) / period) as usize;
        let start = self.tick(first);
        let (mut times, mut values) = (Vec::with_capacity(count), Vec::with_capacity(count));
        for k in 0..=count {
            let tick = start + k as f64 * period;
            let by_law = self.outputs(&law, flight, tick, timing);
            let value = match by_law {
                Some(by_law) => {
                    let miss = cursor.at(tick);
                    std::array::from_fn(|i| (by_law[i] + miss[i]).clamp(0.0, 1.0))
                }
                None => logged.at(tick),
            };
            times.push(tick + 0.5 * period);
            values.push(value);
        }
        Some(Series::from_parts(times, values))
    }

    /// Share of the logged outputs' variance that the law leaves; `None` where they do not vary.
    fn unexplained(
        &self,
        law: &AttitudeLoop,
        flight: &PreparedFlight,
        timing: Timing,
    ) -> Option<f64> {
        let logged = &flight.logged_outputs;
        let stride = (logged.times().len() / 2000).max(1);
        let (mut sums, mut count) = ([[0.0; 4]; 4], 0.0);
        for (time, u) in logged.times().iter().zip(logged.values()).step_by(stride) {
            if !flight.spans.iter().any(|span| span.contains(time)) {
                continue;
            }
            let Some(by_law) = self.outputs(law, flight, self.tick(*time), timing) else {
                continue;
            };
            count += 1.0;
            for i in 0..4 {
                let miss = u[i] - by_law[i];
                for (sum, x) in sums[i].iter_mut().zip([miss, miss * miss, u[i], u[i] * u[i]]) {
                    *sum += x;
                }
            }
        }
        let variance = |sum: f64, square: f64| square - sum * sum / count;
        let left: f64 = sums.iter().map(|[m, mm, ..]| variance(*m, *mm)).sum();
        let total: f64 = sums.iter().map(|[.., u, uu]| variance(*u, *uu)).sum();
        (count > 100.0 && total > 0.0).then(|| left / total)
    }
}

/// The setpoint of this index, unless it is stale at `time` or does not say how much thrust.
fn setpoint(flight: &PreparedFlight, index: usize, time: f64) -> Option<OnboardSetpoint> {
    if time - flight.setpoint.times()[index] > AGE_MAX_S {
        return None;
    }
    let setpoint = &flight.setpoint.values()[index];
    Some(OnboardSetpoint {
        attitude: setpoint.attitude.map(|attitude| attitude.euler()),
        body_rate: setpoint.body_rate.unwrap_or(Frd::zero()),
        thrust: setpoint.thrust?.clamp(0.0, 1.0),
        type_mask: wire::dialect::AttitudeTargetTypemask::empty(),
    })
}

/// The setpoint in force that was sent by `sent`.
pub fn setpoint_at(flight: &PreparedFlight, sent: f64) -> Option<OnboardSetpoint> {
    setpoint(flight, flight.setpoint.index_at(sent)?, sent)
}

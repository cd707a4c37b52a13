//! The vehicle's present condition, and the observation that the supervisor gets of it.

use std::time::Duration;

use message::{ChargeState, LandedState};
use vehicle::frame::Ned;

use super::OffboardController;
use crate::clock::HostTime;
use crate::supervisor::{
    FlightCondition, FlightState, Observation, PreflightCheck, Severity, Standing, UplinkDelay,
    preflight,
};

/// Share of the preflight tick rate that must be kept while a hold is streamed. Below 1, so that a
/// pause too short to make the state stale does not end the stream.
const STREAMING_RATE_SHARE: f64 = 0.6;

/// The most that an empty pack, or a misread voltage, raises the thrust.
const VOLTAGE_GAIN_MAX: f64 = 1.4;

/// Speed below which a vehicle at ground height counts as at rest, m/s.
const RESTING_SPEED_M_S: f64 = 0.15;

/// Height above the ground that counts as flight where the vehicle does not report it, m.
const AIRBORNE_HEIGHT_M: f64 = 0.3;

/// Silence on TIMESYNC, which is sent ten times a second, after which setpoints may not arrive.
const UNANSWERED: Duration = Duration::from_millis(250);
/// For this long after that, the vehicle may be somewhere that no setpoint sent it.
const UNREACHABLE_RECENT: Duration = Duration::from_secs(2);
/// An older answer says nothing about the present link.
const ANSWER_FRESH: Duration = Duration::from_millis(500);
/// After as long without a second answer the link no longer repeats what is sent: of the requests,
/// ten a second, two in a row were not repeated.
const AGAIN_FRESH: Duration = Duration::from_millis(250);

impl OffboardController {
    /// Gathers the observation of vehicle and clock, and hands it to the supervisor.
    pub(super) fn observe(&mut self, now: HostTime) {
        let before = self.supervisor.state();
        if let Some(late) = self.telemetry.take_late(now) {
            let limit_s = self.settings.telemetry.late_after_s;
            let text = format!(
                "{late}; ignored (offboard.telemetry.late_after_s is {limit_s}); the link is \
                 congested, or this machine is busy"
            );
            self.supervisor.report(now, Severity::Warning, text);
        }
        let age_s = self.telemetry.age_s(now).max(std::mem::take(&mut self.paused_s));
        let rate_hz = self.settings.telemetry.rate_hz;
        let here = self.telemetry.last_sample().map(|sample| sample.state);
        // One observation can lead through Preflight to the stream, so the checks must run before
        // it.
        let failed = match before.precedes_stream() {
            true => self.checks(now),
            false => std::mem::take(&mut self.failed_checks),
        };
        let jumped = std::mem::take(&mut self.jumped);
        if self.may_be_unreachable(now) {
            self.unreachable_at = Some(now);
        }
        let condition = FlightCondition { sample_age_s: age_s, jumped, ..self.condition(now) };
        let status = self.telemetry.status();
        let tick_rate_min = self.settings.preflight.tick_rate_min
            * if before.precedes_stream() { 1.0 } else { STREAMING_RATE_SHARE };
        let airborne = self.airborne();
        let observation = Observation {
            status,
            airborne,
            at_rest: self.is_at_rest(),
            speed_m_s: here.map_or(0.0, |s| s.velocity.north().hypot(s.velocity.east())),
            telemetry_ready: airborne.is_some()
                && status.armed.is_some()
                && age_s < self.settings.safety.stale_after_s
                && self.telemetry.tick_rate_hz() >= tick_rate_min * rate_hz,
            preflight: &failed,
            condition,
        };
        self.supervisor.observe(now, &observation);
        self.failed_checks = failed;
        let after = self.supervisor.state();
        if after != before {
            self.tracking_error = 0.0;
        }
        if after.is_over() {
            self.end_adjustment(now);
        }
        if matches!(after, FlightState::Hold | FlightState::Land) && jumped {
            self.guidance.hold_here();
        } else if after == FlightState::Hold && after != before {
            // A reaction led here: stop near the vehicle's position, not at the reference.
            self.guidance.stop_ahead();
        }
        let silence_s = self.telemetry.status().silence_s(now);
        if silence_s.is_finite() && silence_s > self.settings.supervisor.link_lost_after_s {
            self.forget();
        }
    }

    /// The preflight checks that fail, including the standing ones.
    fn checks(&self, now: HostTime) -> Vec<PreflightCheck> {
        let here = self.telemetry.last_sample().map(|sample| sample.state.position);
        let standing = Standing {
            rate_hz: self.settings.telemetry.rate_hz,
            link_loss: self.link_loss,
            uplink: self.uplink(now),
            start_distance_m: here.map_or(f64::NAN, |here| self.guidance.start_distance_m(here)),
            airborne: self.airborne(),
            ground_seen: self.guidance.ground().is_some(),
            policy: self.policy,
            take_over: self.settings.supervisor.take_over,
        };
        let mut failed = self.standing_checks.clone();
        failed.extend(preflight(&self.settings.preflight, &standing, &self.telemetry, now));
        failed
    }

    /// The quantities that faults are judged by, without the sample's age, jumps and failsafes.
    fn condition(&self, now: HostTime) -> FlightCondition<'static> {
        let here = self.telemetry.last_sample().map(|sample| sample.state);
        let from_anchor = match (here, self.guidance.anchor()) {
            (Some(here), Some(anchor)) => here.position - anchor,
            _ => Ned::zero(),
        };
        let status = self.telemetry.status();
        FlightCondition {
            late: self.telemetry.late(),
            uplink: self.uplink(now),
            was_unreachable: self
                .unreachable_at
                .is_some_and(|at| now.since(at) < UNREACHABLE_RECENT),
            tracking_error_m: self.tracking_error,
            tilt_rad: here.map_or(f64::NAN, |s| s.attitude.tilt()),
            radius_m: (from_anchor.north().powi(2) + from_anchor.east().powi(2)).sqrt(),
            height_m: -from_anchor.down(),
            battery: status.battery.remaining,
            battery_critical: status.battery.charge == ChargeState::Critical,
            position_lost: status.position_healthy == Some(false),
            ..FlightCondition::default()
        }
    }

    /// Factor on the commanded thrust that makes up for the pack's voltage below full.
    pub(super) fn voltage_gain(&self) -> f64 {
        let voltage = self.telemetry.status().battery.voltage;
        voltage.map_or(1.0, |voltage| {
            let ratio = voltage / self.airframe.battery_full_v;
            ratio.powf(-self.guidance.voltage_exponent()).clamp(1.0, VOLTAGE_GAIN_MAX)
        })
    }

    /// Whether setpoints may not arrive: a vehicle that used to answer has been silent for as long
    /// as several answers take. Its motion then need not follow the setpoints.
    pub(super) fn may_be_unreachable(&self, now: HostTime) -> bool {
        self.round_trip.is_some_and(|(at, time)| now.since(at) > UNANSWERED + time)
    }

    /// Whether setpoints may reach the vehicle too late for a lift-off.
    pub(super) fn answers_late(&self, now: HostTime) -> bool {
        self.may_be_unreachable(now) || self.settings.safety.is_link_slow(self.uplink(now))
    }

    fn uplink(&self, now: HostTime) -> UplinkDelay {
        let recent = |newest: Option<(HostTime, Duration)>, for_up_to| {
            let (_, time) = newest.filter(|(at, _)| now.since(*at) < for_up_to)?;
            Some(time.as_secs_f64())
        };
        UplinkDelay {
            round_trip_s: recent(self.round_trip, ANSWER_FRESH),
            again_s: recent(self.again, AGAIN_FRESH),
        }
    }

    /// Whether the vehicle is off the ground, as it reports. If it does not report this, a disarmed
    /// vehicle is on the ground, and an armed one flies when it is above the place where it last
    /// stood. `None` where neither is known: an armed vehicle may be anywhere.
    pub(super) fn airborne(&self) -> Option<bool> {
        let status = self.telemetry.status();
        match status.landed {
            LandedState::OnGround => Some(false),
            LandedState::InAir | LandedState::TakingOff | LandedState::Landing => Some(true),
            LandedState::Undefined if status.armed? => Some(self.height_m()? > AIRBORNE_HEIGHT_M),
            LandedState::Undefined => Some(false),
        }
    }

    /// Height above the place where the vehicle was last seen on the ground, m.
    fn height_m(&self) -> Option<f64> {
        let here = self.telemetry.last_sample()?.state.position;
        Some(self.guidance.ground()?.down() - here.down())
    }

    /// Whether the vehicle is at rest at ground height, according to its own estimate.
    fn is_at_rest(&self) -> bool {
        let speed = self.telemetry.last_sample().map(|sample| sample.state.velocity.norm());
        self.height_m().is_some_and(|height| height.abs() < AIRBORNE_HEIGHT_M)
            && speed.is_some_and(|speed| speed < RESTING_SPEED_M_S)
    }
}

//! Which message triggers a control tick, and which telemetry is accepted.

use std::time::Duration;

use downwash::clock::{HostTime, VehicleTime};
use downwash::link::received::Received;
use downwash::link::vehicle_clock::{Delay, VehicleClock};
use downwash::telemetry::{Sample, SampleSource, Telemetry, TelemetryFault, TelemetrySettings};
use message::{AttitudeSource, Inbound};
use proptest::prelude::*;
use vehicle::frame::{Attitude, Euler, Frd, Ned};

const START: HostTime = HostTime::from_ns(1_000_000_000_000);

fn received(us: u64, message: Inbound) -> Received {
    let host = START + Duration::from_micros(us + 2000);
    Received { host, vehicle: Some(VehicleTime::from_us(us)), delay: None, message }
}

/// Moving north at 1 m/s and turning at 0.5 rad/s.
fn pose(us: u64) -> (Ned, Ned, Attitude, Frd) {
    let t = us as f64 * 1e-6;
    let attitude = Euler::new(0.0, 0.0, 0.5 * t).attitude();
    (Ned::new(t, 0.0, -1.0), Ned::new(1.0, 0.0, 0.0), attitude, Frd::new(0.0, 0.0, 0.5))
}

fn odometry(us: u64) -> Received {
    let (position, velocity, attitude, body_rate) = pose(us);
    let reset_counter = 0;
    received(us, Inbound::Odometry { position, velocity, attitude, body_rate, reset_counter })
}

fn attitude(us: u64, source: AttitudeSource) -> Received {
    let (_, _, attitude, body_rate) = pose(us);
    received(us, Inbound::Attitude { source, attitude, body_rate })
}

fn position(us: u64) -> Received {
    let (position, velocity, ..) = pose(us);
    received(us, Inbound::LocalPosition { position, velocity })
}

/// A period in us, and the message at a timestamp.
type Stream = (u64, fn(u64) -> Received);

/// Feeds what `streams` send at their periods (us) until `end_us`, in order of timestamps.
fn run(telemetry: &mut Telemetry, streams: &[Stream], end_us: u64) -> Vec<Sample> {
    let mut messages: Vec<_> = streams
        .iter()
        .enumerate()
        .flat_map(|(i, (period, make))| {
            (1..=end_us / period).map(move |k| (k * period, i, make(k * period)))
        })
        .collect();
    messages.sort_by_key(|(us, i, _)| (*us, *i));
    messages
        .iter()
        .filter_map(|(_, _, message)| telemetry.update(message).expect("sound"))
        .collect()
}

fn quaternion(us: u64) -> Received {
    attitude(us, AttitudeSource::Quaternion)
}

fn euler(us: u64) -> Received {
    attitude(us, AttitudeSource::Euler)
}

fn telemetry() -> Telemetry {
    Telemetry::new(TelemetrySettings::default())
}

#[test]
fn odometry_at_the_control_rate_triggers_each_tick() {
    let samples = run(&mut telemetry(), &[(10_000, odometry)], 2_000_000);
    assert!((190..=200).contains(&samples.len()), "{}", samples.len());
    assert!(samples.iter().all(|sample| sample.source == SampleSource::Odometry));
}

#[test]
fn faster_odometry_is_decimated_without_drift() {
    let samples = run(&mut telemetry(), &[(4_000, odometry)], 10_000_000);
    assert!((990..=1001).contains(&samples.len()), "{}", samples.len());
}

#[test]
fn odometry_slightly_below_the_rate_loses_no_tick() {
    let samples = run(&mut telemetry(), &[(10_100, odometry)], 10_000_000);
    assert!(samples.len() >= 980, "{}", samples.len());
}

#[test]
fn slow_odometry_yields_to_attitude_and_position() {
    let streams: [Stream; 3] = [(33_000, odometry), (4_000, quaternion), (10_000, position)];
    let samples = run(&mut telemetry(), &streams, 2_000_000);
    assert!((195..=200).contains(&samples.len()), "{}", samples.len());
    let pair = SampleSource::Pair(AttitudeSource::Quaternion);
    assert!(samples.iter().all(|sample| sample.source == pair));
}

/// Samples before a stream's rate is known.
const UNMEASURED: usize = 5;

/// The ticks triggered at `rate_hz` by ODOMETRY with these timestamps, us, each with its delay, us.
fn ticks_of(rate_hz: f64, stamps: impl IntoIterator<Item = (u64, u64)>) -> Vec<u64> {
    let mut telemetry = Telemetry::new(TelemetrySettings { rate_hz, ..Default::default() });
    let mut ticks = Vec::new();
    for (us, delay_us) in stamps {
        let mut message = odometry(us);
        message.host = message.host + Duration::from_micros(delay_us);
        if telemetry.update(&message).expect("sound").is_some() {
            ticks.push(us);
        }
    }
    ticks
}

/// Evenly spread over 0 to 1, and the same in every run.
fn noise(k: u64) -> f64 {
    (k as f64 * 0.618_033_988_749_894_9).fract()
}

#[test]
fn every_sample_is_answered_at_the_control_rate_despite_jitter() {
    for rate_hz in [100.0, 500.0] {
        let period_us = 1e6 / rate_hz;
        // Each timestamp is off by up to a fifth of a period, each arrival by up to two periods.
        let stamps = (1..20_000).map(|k| {
            let us = (k as f64 + 0.4 * (noise(k) - 0.5)) * period_us;
            (us as u64, (2.0 * noise(k * k) * period_us) as u64)
        });
        assert_eq!(ticks_of(rate_hz, stamps).len(), 19_999 - UNMEASURED, "{rate_hz} Hz");
    }
}

#[test]
fn vehicle_pause_loses_no_later_tick() {
    for rate_hz in [100.0, 500.0] {
        let period_us = (1e6 / rate_hz) as u64;
        // Every 100 samples the vehicle stalls for eight periods.
        let stamps: Vec<_> = (1..5_000).map(|k| ((k + 8 * (k / 100)) * period_us, 0)).collect();
        let ticks = ticks_of(rate_hz, stamps.iter().copied());
        assert_eq!(ticks.len(), stamps.len() - UNMEASURED, "{rate_hz} Hz");
    }
}

#[test]
fn faster_odometry_is_decimated_to_the_rate_on_average() {
    // 4 ms, and 7.5 ms as alternating 7 and 8.
    let even = (1..=2_500).map(|k| (k * 4_000, 0));
    let uneven = (1..=1_333).map(|k| (k * 7_500 / 1000 * 1000, 0));
    for ticks in [ticks_of(100.0, even), ticks_of(100.0, uneven)] {
        for second in 1..9 {
            let of_it = ticks.iter().filter(|us| **us / 1_000_000 == second).count();
            assert!((99..=101).contains(&of_it), "{of_it} in second {second}");
        }
    }
}

#[test]
fn slow_odometry_is_used_without_a_better_source() {
    let samples = run(&mut telemetry(), &[(12_000, odometry), (50_000, position)], 3_000_000);
    assert!(samples.len() >= 240, "{}", samples.len());
    assert!(samples.iter().all(|sample| sample.source == SampleSource::Odometry));
}

#[test]
fn attitude_and_position_are_extrapolated_to_the_newer_stamp() {
    // Attitude 3 ms before or after the position.
    for offset in [3_000i64, -3_000] {
        let mut telemetry = telemetry();
        let mut checked = 0;
        for k in 1..100u64 {
            let at = k * 10_000;
            let mut both = [quaternion((at as i64 + offset) as u64), position(at)];
            both.sort_by_key(|message| message.vehicle);
            for message in &both {
                if let Some(sample) = telemetry.update(message).expect("sound") {
                    let (p, _, q, _) = pose(sample.vehicle.as_us());
                    assert!((sample.state.position - p).norm() < 1e-9);
                    assert!(sample.state.attitude.angle_to(q) < 1e-9);
                    checked += 1;
                }
            }
        }
        assert!(checked > 95);
    }
}

#[test]
fn two_attitude_sources_are_never_mixed() {
    let streams: [Stream; 3] = [(10_000, quaternion), (10_100, euler), (10_000, position)];
    let samples = run(&mut telemetry(), &streams, 2_000_000);
    let pair = SampleSource::Pair(AttitudeSource::Quaternion);
    assert!(samples.len() > 190 && samples.iter().all(|sample| sample.source == pair));
}

#[test]
fn position_jump_is_reported_once() {
    let mut telemetry = telemetry();
    run(&mut telemetry, &[(10_000, odometry)], 1_000_000);
    let shifted = |us: u64, by: f64| {
        let mut message = odometry(us);
        if let Inbound::Odometry { position, .. } = &mut message.message {
            *position += Ned::new(0.0, by, 0.0);
        }
        message
    };
    let jump = telemetry.update(&shifted(1_010_000, 2.0));
    assert!(matches!(jump, Err(TelemetryFault::PositionJump { metres, .. }) if metres > 1.9));
    assert!(matches!(telemetry.update(&shifted(1_020_000, 2.0)), Ok(Some(_))));
}

#[test]
fn reset_restart_and_repeat_are_distinguished() {
    let mut telemetry = telemetry();
    run(&mut telemetry, &[(10_000, odometry)], 3_000_000);
    assert_eq!(telemetry.update(&odometry(3_000_000)), Err(TelemetryFault::OutOfOrder));
    let mut reset = odometry(3_010_000);
    if let Inbound::Odometry { reset_counter, .. } = &mut reset.message {
        *reset_counter = 1;
    }
    assert_eq!(telemetry.update(&reset), Err(TelemetryFault::EstimateReset));
    let mut restart = odometry(100_000);
    restart.host = START + Duration::from_secs(4);
    assert!(matches!(telemetry.update(&restart), Err(TelemetryFault::Reboot { .. })));
    assert!(telemetry.last_sample().is_none(), "no state from before the restart remains");
}

#[test]
fn clock_step_beside_a_slightly_older_stamp_is_no_restart() {
    let mut telemetry = telemetry();
    run(&mut telemetry, &[(10_000, odometry)], 3_000_000);
    let mut early = odometry(2_999_000);
    early.delay = Some(Delay { seconds: -1.2, at_least_s: -1.2 });
    assert_eq!(telemetry.update(&early), Err(TelemetryFault::ClockJump { seconds: 1.2 }));
}

/// A vehicle's messages as the link forwards them, each with its delay.
#[derive(Default)]
struct Link {
    clock: VehicleClock,
}

impl Link {
    fn deliver(
        &mut self,
        telemetry: &mut Telemetry,
        host: HostTime,
        message: Received,
    ) -> Result<Option<Sample>, TelemetryFault> {
        let delay = message.vehicle.map(|stamp| self.clock.observe(host, stamp));
        telemetry.update(&Received { host, delay, ..message })
    }

    fn second(&mut self, telemetry: &mut Telemetry) {
        for us in (10_000..=1_000_000).step_by(10_000) {
            let message = odometry(us);
            self.deliver(telemetry, message.host, message).expect("sound");
        }
    }
}

#[test]
fn late_message_is_rejected_and_reported() {
    let (mut telemetry, mut link) = (telemetry(), Link::default());
    link.second(&mut telemetry);
    assert_eq!(telemetry.take_late(START), None);
    let late = odometry(1_010_000);
    let host = late.host + Duration::from_millis(300);
    let fault = link.deliver(&mut telemetry, host, late);
    assert!(matches!(fault, Err(TelemetryFault::Late { .. })), "{fault:?}");
    let notice = telemetry.take_late(host).expect("a notice").to_string();
    assert_eq!(notice, "1 state message arrived up to 0.30 s late");
    assert_eq!((telemetry.take_late(host), telemetry.late().count), (None, 1));
    let next = odometry(1_320_000);
    assert!(matches!(link.deliver(&mut telemetry, next.host, next), Ok(Some(_))));
    assert_eq!(telemetry.late().count, 0);
}

#[test]
fn queue_overflow_is_not_a_clock_jump() {
    let (mut telemetry, mut link) = (telemetry(), Link::default());
    link.second(&mut telemetry);
    // Nothing is read for 1.5 s. Old messages then arrive at once, those that the queue could not
    // hold are missing, and the newest follows.
    let read = START + Duration::from_micros(2_500_000);
    for us in (1_010_000..1_100_000).step_by(10_000) {
        let late = link.deliver(&mut telemetry, read, odometry(us));
        assert!(matches!(late, Err(TelemetryFault::Late { .. })), "{late:?}");
    }
    let fresh = link.deliver(&mut telemetry, read, odometry(2_490_000));
    assert!(matches!(fresh, Ok(Some(_))), "{fresh:?}");
}

#[test]
fn forward_clock_step_is_reported_once() {
    let (mut telemetry, mut link) = (telemetry(), Link::default());
    link.second(&mut telemetry);
    let mut stepped = |us: u64| {
        let host = START + Duration::from_micros(us + 2000);
        link.deliver(&mut telemetry, host, odometry(us + 1_200_000))
    };
    let jump = stepped(1_010_000);
    assert!(
        matches!(jump, Err(TelemetryFault::ClockJump { seconds }) if (seconds - 1.2).abs() < 0.01),
        "{jump:?}"
    );
    assert!(stepped(1_020_000).is_ok());
}

proptest! {
    /// Whatever is sent, ticks are never closer than half the period, timestamps increase, and
    /// states are finite.
    #[test]
    fn ticks_keep_their_minimum_spacing(gaps in prop::collection::vec((1u64..30_000, 0u8..4, any::<bool>()), 1..400)) {
        let mut telemetry = telemetry();
        let (mut us, mut before) = (0, None::<Sample>);
        for (gap, kind, nan) in gaps {
            us += gap;
            let mut message = match kind {
                0 => odometry(us),
                1 => quaternion(us),
                2 => euler(us),
                _ => position(us),
            };
            if let (true, Inbound::LocalPosition { position, .. }) = (nan, &mut message.message) {
                *position = Ned::new(0.0, f64::NAN, 0.0);
            }
            if let Ok(Some(sample)) = telemetry.update(&message) {
                prop_assert!(sample.state.is_finite());
                if let Some(before) = before {
                    prop_assert!(sample.vehicle.seconds_since(before.vehicle) > 0.00499);
                }
                before = Some(sample);
            }
        }
    }
}

//! A station and the simulated vehicle in one thread, on one virtual clock. They exchange the bytes
//! that they would exchange over a link.

use std::time::Duration;

use sitl::autopilot::{self, LinkKind, Vehicle};
use wire::transport::Peer;

use crate::clock::{HostTime, VehicleTime};
use crate::log::record::{Record, Stamp, Truth};
use crate::station::{End, Station};

/// The virtual host clock when the vehicle's reads 0: 2026-01-01 00:00 UTC. The date means nothing
/// in simulation, and is fixed so that the same seed gives the same log.
pub const EPOCH: HostTime = HostTime::from_ns(1_767_225_600_000_000_000);

/// Period of the true state in the log, us.
const TRUTH_PERIOD_US: u64 = 10_000;

/// Longest time between two polls of the station, us of host time.
const LOOK_WITHIN_US: u64 = 20_000;

/// The only peers: each end's number for the other.
const VEHICLE: Peer = Peer::new(0);
const STATION: autopilot::Peer = autopilot::Peer(0);

/// Why a lockstep flight did not end.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error("the flight did not end within {limit_s} s of simulated time; it was in {phase}")]
pub struct Endless {
    limit_s: f64,
    phase: &'static str,
}

/// Host time `us` after the vehicle was switched on. It is the vehicle's own time unless its clock
/// slips.
pub fn host_time(us: u64) -> HostTime {
    EPOCH + Duration::from_micros(us)
}

/// Flies until the station's flight has ended and nothing more is to be recorded. Passes every
/// record to `log`, and the station to `watch` about every 10 ms of simulated time. Returns how the
/// flight ended.
///
/// # Errors
/// [`Endless`] after `limit_s` of simulated time.
pub fn fly(
    vehicle: &mut Vehicle,
    station: &mut Station,
    limit_s: f64,
    log: impl FnMut(Record),
    watch: impl FnMut(&Station, HostTime),
) -> Result<End, Endless> {
    fly_disturbed(vehicle, station, limit_s, log, watch, |_, _| {})
}

/// Like [`fly`], but `act` may change the vehicle before each of its time steps.
///
/// # Errors
/// [`Endless`] after `limit_s` of simulated time.
pub fn fly_disturbed(
    vehicle: &mut Vehicle,
    station: &mut Station,
    limit_s: f64,
    mut log: impl FnMut(Record),
    mut watch: impl FnMut(&Station, HostTime),
    mut act: impl FnMut(&mut Vehicle, &mut Station),
) -> Result<End, Endless> {
    vehicle.connect(STATION, LinkKind::Datagrams);
    let limit_us = vehicle.now_us() + (limit_s * 1e6) as u64;
    let mut truth_due = vehicle.now_us();
    let mut host_us = vehicle.clock().host_us(vehicle.now_us());
    loop {
        let now_us = vehicle.now_us();
        let now = host_time(host_us);
        vehicle.take_output(|_, frame| station.receive(now, VEHICLE, frame, true));
        if station.next_deadline(now) <= now || now_us >= truth_due {
            station.poll(now);
        }
        station.transmit(now, |_, frame| {
            vehicle.receive(STATION, frame);
            true
        });
        if now_us >= truth_due {
            truth_due += TRUTH_PERIOD_US;
            log(truth(vehicle, now));
            watch(station, now);
        }
        station.take_records(&mut log);
        if station.is_over() || now_us >= limit_us {
            let phase = station.status().phase.map_or("connect", |phase| phase.name());
            return station.end().cloned().ok_or(Endless { limit_s, phase });
        }
        act(vehicle, station);
        let due_us = vehicle.clock().host_us(vehicle.next_event_us().min(truth_due));
        // While the vehicle's clock stands still, the station's runs on.
        host_us = due_us.min(host_us + LOOK_WITHIN_US);
        vehicle.advance_to(vehicle.clock().vehicle_us(host_us));
    }
}

/// The true state of the vehicle at host time `now`.
pub fn truth(vehicle: &Vehicle, now: HostTime) -> Record {
    let plant = vehicle.plant();
    Record::Truth {
        stamp: Stamp::new(now, VehicleTime::from_us(vehicle.now_us()), now),
        truth: Truth {
            state: *plant.state(),
            acceleration: plant.acceleration(),
            angular_acceleration: plant.angular_acceleration(),
            rotor_thrust: plant.rotor_thrusts(),
        },
    }
}

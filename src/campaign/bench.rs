//! One flight of a script: station, vehicle, link and pilot on one virtual clock.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use sitl::autopilot::VehicleRefused;
use wire::transport::Peer;

use super::aircraft::Aircraft;
pub use super::aircraft::set_up;
use super::channel::Channel;
use super::coverage::Coverage;
use super::judge::{Ending, Judge};
use super::kit::{Flown, Kit};
use super::planner::{self, SharedTime};
use super::script::{Fault, Script};
use super::signing;
use crate::clock::HostTime;
use crate::lockstep;
use crate::log::record::Record;
use crate::station::{PAUSE, Station, StationSettings};
use crate::supervisor::EngagePolicy;

const VEHICLE: Peer = Peer::new(0);

/// Interval at which the judge observes the true state, us.
const SEEN_US: u64 = 10_000;
/// Longest interval between turns of the station, us.
const LOOK_US: u64 = 20_000;
/// Time limit of a commanded flight; under the pilot's switch, the station is stopped at the second
/// time, us.
const LIMIT_US: u64 = 200_000_000;
const SWITCHED_US: u64 = 26_000_000;
/// Time limit for the vehicle's failsafe to act without setpoints, us.
const ADRIFT_US: u64 = 15_000_000;

/// Flies a script.
///
/// # Errors
/// The vehicle cannot be simulated.
pub fn fly(script: &Script, kit: &Kit) -> Result<Flown, VehicleRefused> {
    let planner_us: SharedTime = Arc::new(AtomicU64::new(0));
    let reference = planner::faulty(script, Arc::clone(&kit.settings.reference), &planner_us);
    let mut session = kit.settings.session.clone();
    session.signing = script.signed.then(signing::settings);
    let settings = StationSettings {
        reference,
        session,
        policy: script.policy,
        search_timeout_s: (script.policy == EngagePolicy::Command)
            .then_some(kit.settings.search_timeout_s.unwrap_or(20.0)),
        ..kit.settings.clone()
    };
    let mut bench = Bench {
        script,
        station: Some(Station::new(settings.clone(), lockstep::host_time(0))),
        settings,
        aircraft: Aircraft::new(script, kit, lockstep::EPOCH)?,
        channel: Channel::new(script.seed),
        judge: Judge::new(script, kit.bounds, &kit.path),
        coverage: Coverage::default(),
        planner_us,
        now_us: 0,
        begun_us: 0,
        turned_us: 0,
        seen_us: 0,
        digest: crc32fast::Hasher::new(),
        end: None,
    };
    bench.fly()?;
    Ok(bench.flown())
}

struct Bench<'a> {
    script: &'a Script,
    settings: StationSettings,
    /// `None` while its process does not run.
    station: Option<Station>,
    aircraft: Aircraft<'a>,
    channel: Channel,
    judge: Judge,
    coverage: Coverage,
    planner_us: SharedTime,
    now_us: u64,
    /// All faults that start earlier have begun.
    begun_us: u64,
    /// When the station last ran.
    turned_us: u64,
    /// When the judge next observes the true state.
    seen_us: u64,
    digest: crc32fast::Hasher,
    /// The station's own account of the flight's end.
    end: Option<String>,
}

impl Bench<'_> {
    fn now(&self) -> HostTime {
        lockstep::EPOCH + Duration::from_micros(self.now_us)
    }

    fn acts(&self, fault: Fault) -> bool {
        self.script.faults.iter().any(|timed| timed.fault == fault && timed.acts(self.now_us))
    }

    /// Runs from switching on until the station has ended and the vehicle is under someone's
    /// control.
    fn fly(&mut self) -> Result<(), VehicleRefused> {
        let limit_us = LIMIT_US;
        loop {
            self.planner_us.store(self.now_us, Ordering::Relaxed);
            self.begin_faults()?;
            self.aircraft.send(self.now_us, &mut self.channel);
            self.turn();
            self.aircraft.listen(self.now_us, &mut self.channel, &mut self.judge);
            self.see();
            if self.station.as_ref().is_some_and(Station::is_over) {
                break;
            }
            if self.now_us >= limit_us {
                self.judge.ends(self.now_us, None);
                return Ok(());
            }
            self.advance();
        }
        // The program has ended, so nothing answers any more.
        let ended = self.station.take();
        self.end = ended.as_ref().and_then(Station::end).map(|end| format!("{end:?}"));
        let adrift_us = self.now_us + ADRIFT_US;
        while self.aircraft.ending() == Ending::Adrift && self.now_us < adrift_us {
            // The pilot, for one, acts on.
            self.begin_due()?;
            self.aircraft.send(self.now_us, &mut self.channel);
            while self.channel.receive_down(self.now_us).is_some() {}
            self.aircraft.listen(self.now_us, &mut self.channel, &mut self.judge);
            self.advance();
        }
        self.judge.ends(self.now_us, Some(self.aircraft.ending()));
        Ok(())
    }

    fn flown(self) -> Flown {
        let ending = self.station.is_none().then(|| self.aircraft.ending());
        Flown {
            end: self.end.unwrap_or_default(),
            ending,
            violations: self.judge.violations().to_vec(),
            setpoints: self.judge.setpoints,
            simulated_s: self.now_us as f64 * 1e-6,
            coverage: self.coverage,
            digest: self.digest.finalize(),
        }
    }

    fn begin_faults(&mut self) -> Result<(), VehicleRefused> {
        if self.begin_due()? {
            self.station = None;
        }
        let is_down = self.acts(Fault::Restart);
        if self.station.is_none() && !is_down {
            // As in the stamps' file: stamps up to a second before the end are known.
            if let Some(signing) = &mut self.settings.session.signing {
                signing.before = signing.ledger.get();
            }
            self.station = Some(Station::new(self.settings.clone(), self.now()));
            self.judge.restarted(self.now_us);
            self.turned_us = self.now_us;
        }
        Ok(())
    }

    /// Begins the faults that are due; returns whether the station's process restarts.
    fn begin_due(&mut self) -> Result<bool, VehicleRefused> {
        let script = self.script;
        let to_us = self.now_us + 1;
        let from_us = std::mem::replace(&mut self.begun_us, to_us);
        let mut restarts = false;
        for timed in script.faults.iter().filter(|it| it.begins(from_us, to_us)) {
            self.aircraft.begin(&timed.fault, self.now_us, &mut self.judge)?;
            restarts |= timed.fault == Fault::Restart;
        }
        Ok(restarts)
    }

    /// One turn of the station's process: reads what arrived, answers, polls.
    fn turn(&mut self) {
        let now_us = self.now_us;
        if self.station.is_none() {
            // Nothing reads, so the system drops what arrives.
            while self.channel.receive_down(now_us).is_some() {}
            return;
        }
        if self.acts(Fault::Pause) {
            return;
        }
        let now = self.now();
        let stalled = Duration::from_micros(now_us - self.turned_us);
        self.turned_us = now_us;
        self.judge.runs(now_us);
        while let Some(frame) = self.channel.receive_down(now_us) {
            self.digest.update(&frame.bytes);
            let Self { judge, station: Some(station), .. } = self else { return };
            judge.station_received(now_us, &frame);
            if stalled > PAUSE {
                station.catch_up(now, VEHICLE, &frame.bytes, true);
            } else {
                station.receive(now, VEHICLE, &frame.bytes, true);
                self.transmit();
            }
        }
        let is_stuck = self.acts(Fault::LogStuck);
        let Some(station) = &mut self.station else { return };
        if stalled > PAUSE {
            station.resumed(now, stalled);
        }
        station.poll(now);
        if self.script.policy == EngagePolicy::PilotSwitch && now_us >= SWITCHED_US {
            station.land(now);
        }
        if !is_stuck {
            station.take_records(|record| {
                if let Record::Event { source, text, .. } = record {
                    tracing::debug!("{:.3} s, {source:?}: {text}", now_us as f64 * 1e-6);
                }
            });
        }
        self.transmit();
    }

    fn transmit(&mut self) {
        let (now, now_us) = (self.now(), self.now_us);
        let is_jammed = self.acts(Fault::Jammed);
        let Self { station, channel, judge, script, digest, .. } = self;
        let Some(station) = station else { return };
        station.transmit(now, |_, frame| {
            if is_jammed {
                return false;
            }
            digest.update(frame);
            judge.station_sent(now_us, frame);
            channel.send_up(&script.faults, now_us, frame);
            true
        });
    }

    fn see(&mut self) {
        if self.now_us < self.seen_us {
            return;
        }
        self.seen_us = self.now_us + SEEN_US;
        let seen = self.aircraft.seen(self.now_us);
        tracing::trace!("{seen:?}");
        self.judge.sees(&seen);
        let phase = self.station.as_ref().and_then(|station| station.status().phase);
        self.coverage.note(phase, &self.script.faults, self.now_us);
    }

    fn advance(&mut self) {
        let next_us = self
            .aircraft
            .next_event_us()
            .min(self.channel.next_us().max(self.now_us + 1))
            .min(self.now_us + LOOK_US)
            .min(self.script.next_change_us(self.now_us));
        self.now_us = next_us.max(self.now_us + 1);
        self.aircraft.advance_to(self.now_us);
    }
}

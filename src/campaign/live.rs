//! One flight of a script in real time: the simulated vehicle and the link's faults here, the
//! station in its own process on the other side of a socket.

use std::io;
use std::process::{Command, ExitStatus};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use sitl::autopilot::VehicleRefused;

use super::aircraft::Aircraft;
use super::channel::Channel;
use super::coverage::Coverage;
use super::judge::{Ending, IN_TRANSIT_S, Judge};
use super::kit::{Flown, Kit};
use super::process::Process;
use super::relay::Relay;
use super::script::{Fault, Script, Timed, Way};
pub use super::signing::key;
use crate::clock::HostTime;
use crate::supervisor::EngagePolicy;

/// Interval at which the judge observes the true state, us.
const SEEN_US: u64 = 10_000;
/// Longest interval between reads of the socket, us.
const LOOK_US: u64 = 2_000;
/// Time limit of a commanded flight, us.
const LIMIT_US: u64 = 200_000_000;
/// When the stage requests a landing under the pilot's switch, us.
const SWITCHED_US: u64 = 26_000_000;
/// Time limit for the vehicle's failsafe to act without setpoints, us.
const ADRIFT_US: u64 = 15_000_000;
/// The process may not notice a shorter stop than this, us.
const STALL_US: u64 = 60_000;
/// Time limit for the process to listen.
const START_LIMIT: Duration = Duration::from_secs(30);
/// The exit code of a program that panicked.
const PANICKED: i32 = 101;

/// Why a flight was not flown.
#[derive(Debug, thiserror::Error)]
pub enum NotFlown {
    /// The vehicle cannot be simulated.
    #[error(transparent)]
    Vehicle(#[from] VehicleRefused),
    /// The system provided no socket or no process.
    #[error("the station's process: {0}")]
    System(#[from] io::Error),
    /// The flight was interrupted.
    #[error("interrupted")]
    Interrupted,
}

/// The part of a script that can be played on a process from outside. The process's planner and
/// records cannot be made to fail, and a jammed transport becomes a cut of the way up.
pub fn playable(script: &Script) -> Script {
    let outside = |timed: &Timed| {
        let fault = match timed.fault {
            Fault::PlannerStalls
            | Fault::PlannerLies { .. }
            | Fault::PlannerFails
            | Fault::LogStuck => return None,
            Fault::Jammed => Fault::Cut { way: Way::Up },
            fault => fault,
        };
        Some(Timed { fault, ..*timed })
    };
    Script { faults: script.faults.iter().filter_map(outside).collect(), ..script.clone() }
}

/// Flies a [`playable`] script. `station` is the program that flies the vehicle, and listens on a
/// loopback port.
///
/// # Errors
/// [`NotFlown`].
pub fn fly(
    script: &Script,
    kit: &Kit,
    station: &dyn Fn(u16) -> io::Result<Command>,
    stop: &AtomicBool,
) -> Result<Flown, NotFlown> {
    let mut relay = Relay::open()?;
    let process = Process::start(&mut station(relay.station_port())?)?;
    relay.await_station(START_LIMIT)?;
    let epoch = HostTime::from_ns(relay.began().as_nanos() as u64);
    let mut stage = Stage {
        script,
        station,
        process: Some(process),
        aircraft: Aircraft::new(script, kit, epoch)?,
        channel: Channel::new(script.seed),
        judge: Judge::new(script, kit.bounds, &kit.path).patient(IN_TRANSIT_S),
        coverage: Coverage::default(),
        relay,
        now_us: 0,
        begun_us: 0,
        seen_us: 0,
        stopped_us: 0,
        is_end_requested: false,
        end: None,
    };
    stage.fly(stop)?;
    Ok(stage.flown())
}

struct Stage<'a> {
    script: &'a Script,
    station: &'a dyn Fn(u16) -> io::Result<Command>,
    process: Option<Process>,
    aircraft: Aircraft<'a>,
    channel: Channel,
    judge: Judge,
    coverage: Coverage,
    relay: Relay,
    /// The vehicle's time, which follows the wall clock from event to event.
    now_us: u64,
    /// All faults that start earlier have begun.
    begun_us: u64,
    /// When the judge next observes the true state.
    seen_us: u64,
    /// When the process was stopped.
    stopped_us: u64,
    /// Whether the process received a signal to end.
    is_end_requested: bool,
    /// Exit status of the process, once it ended.
    end: Option<ExitStatus>,
}

impl Stage<'_> {
    fn acts(&self, fault: Fault) -> bool {
        self.script.faults.iter().any(|timed| timed.fault == fault && timed.acts(self.now_us))
    }

    /// Runs from switching on until the station has ended and the vehicle is under someone's
    /// control.
    fn fly(&mut self, stop: &AtomicBool) -> Result<(), NotFlown> {
        let mut adrift_us = None;
        loop {
            if stop.load(Ordering::Relaxed) {
                return Err(NotFlown::Interrupted);
            }
            let wall_us = self.relay.now_us();
            self.receive_from_station()?;
            self.follow(wall_us)?;
            if self.end.is_none() {
                self.end = self.process.as_mut().map_or(Ok(None), Process::ended)?;
            }
            if let Some(end) = self.end {
                let until_us = *adrift_us.get_or_insert(self.now_us + ADRIFT_US);
                if self.aircraft.ending() != Ending::Adrift || self.now_us >= until_us {
                    let ending = (!is_crash(end)).then(|| self.aircraft.ending());
                    self.judge.ends(self.now_us, ending);
                    return Ok(());
                }
            } else if self.now_us >= LIMIT_US {
                self.judge.ends(self.now_us, None);
                return Ok(());
            }
            self.relay.wait(self.next_us().min(wall_us + LOOK_US));
        }
    }

    fn flown(self) -> Flown {
        let ended = self.end.filter(|end| !is_crash(*end));
        Flown {
            end: self.end.map_or_else(String::new, |end| end.to_string()),
            ending: ended.map(|_| self.aircraft.ending()),
            violations: self.judge.violations().to_vec(),
            setpoints: self.judge.setpoints,
            simulated_s: self.now_us as f64 * 1e-6,
            coverage: self.coverage,
            // No two flights are identical to the byte.
            digest: 0,
        }
    }

    /// Puts the station's frames onto the way up.
    fn receive_from_station(&mut self) -> io::Result<()> {
        let Self { relay, judge, channel, script, .. } = self;
        relay.take(|sent_us, frame| {
            judge.station_sent(sent_us, frame);
            channel.send_up(&script.faults, sent_us, frame);
        })
    }

    /// Advances the vehicle's time to the wall clock's.
    fn follow(&mut self, wall_us: u64) -> Result<(), NotFlown> {
        loop {
            self.begin_faults()?;
            self.aircraft.send(self.now_us, &mut self.channel);
            while let Some(frame) = self.channel.receive_down(self.now_us) {
                self.judge.station_received(self.relay.now_us(), &frame);
                self.relay.send(&frame.bytes);
            }
            self.aircraft.listen(self.now_us, &mut self.channel, &mut self.judge);
            self.see();
            let next_us = self.next_us();
            if next_us > wall_us {
                return Ok(());
            }
            self.now_us = next_us;
            self.aircraft.advance_to(next_us);
        }
    }

    fn next_us(&self) -> u64 {
        self.aircraft
            .next_event_us()
            .min(self.channel.next_us())
            .min(self.script.next_change_us(self.now_us))
            .max(self.now_us + 1)
    }

    fn begin_faults(&mut self) -> Result<(), NotFlown> {
        let script = self.script;
        let to_us = self.now_us + 1;
        let from_us = std::mem::replace(&mut self.begun_us, to_us);
        for timed in script.faults.iter().filter(|it| it.begins(from_us, to_us)) {
            self.aircraft.begin(&timed.fault, self.now_us, &mut self.judge)?;
        }
        self.treat_process()?;
        Ok(())
    }

    /// Starts, stops and kills the station's process as the script says.
    fn treat_process(&mut self) -> io::Result<()> {
        if self.end.is_some() {
            return Ok(());
        }
        let (is_down, is_stopped) = (self.acts(Fault::Restart), self.acts(Fault::Pause));
        let real_us = self.relay.now_us();
        if is_down {
            self.process = None;
            return Ok(());
        }
        let process = match &mut self.process {
            Some(process) => process,
            None => {
                let mut command = (self.station)(self.relay.station_port())?;
                self.judge.restarted(self.now_us);
                self.is_end_requested = false;
                self.process.insert(Process::start(&mut command)?)
            }
        };
        if process.is_stopped() != is_stopped {
            if is_stopped {
                self.stopped_us = real_us;
            } else if real_us - self.stopped_us > STALL_US {
                self.judge.woke(real_us);
            }
            process.hold(is_stopped);
        }
        let is_over = self.script.policy == EngagePolicy::PilotSwitch && self.now_us >= SWITCHED_US;
        if is_over && !self.is_end_requested {
            self.is_end_requested = true;
            process.request_end();
        }
        Ok(())
    }

    fn see(&mut self) {
        if self.now_us < self.seen_us {
            return;
        }
        self.seen_us = self.now_us + SEEN_US;
        self.judge.sees(&self.aircraft.seen(self.now_us));
        self.coverage.note(None, &self.script.faults, self.now_us);
    }
}

/// Whether a process crashed: it has no exit code, or the code of a panic.
fn is_crash(end: ExitStatus) -> bool {
    end.code().is_none_or(|code| code == PANICKED)
}

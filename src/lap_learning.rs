//! Laps of one closed course, each planned with a model learned from the laps before.
//!
//! The learner receives the records of a flight outside the control thread. It runs the long
//! searches of a training halfway through a lap. When the lap ends it learns from the newest part
//! of the flight and offers the model to the planner in flight. It discards a model that predicts
//! no better than the current one, and the planner rejects a model that gives no flyable plan; the
//! flight then continues with the previous model. Nothing here commands the vehicle: plans reach
//! it as they do without learning, and the supervisor still overrides them.

mod lap;

use std::collections::VecDeque;
use std::time::Duration;

pub use self::lap::Lap;
use self::lap::LapErrors;
use crate::audit::Audit;
use crate::clock::HostTime;
use crate::learn::in_flight::{Discarded, HeldOutErrors, InFlight, Learned};
use crate::learn::segments::Cut;
use crate::learn::training_set::Prepared;
use crate::log::import::{Collected, Flight};
use crate::log::record::{Record, Severity, Source, Tick};
use crate::plan::planned::Answer;
use crate::plan::planner::Planner;
use crate::plan::receding::{Exchange, Verdict};

/// Phase of the ticks that track the course.
const ON_COURSE: &str = "track";
/// Fraction of a lap after which the long searches run.
const PREPARED_AT: f64 = 0.5;
/// Fraction of a lap that must be flown for the lap to count.
const COMPLETE_SHARE: f64 = 0.98;
/// A lap's model is withdrawn above this ratio of its largest error to that of the previous lap.
const WORSE: f64 = 1.5;
/// Above this share of the persistent part in the squared residual, the model limits the next lap.
const LASTING_SHARE: f64 = 0.25;

/// Name of the model in use after a withdrawal.
const BEFORE_WITHDRAWN: &str = "the model used before a withdrawn one";

/// The laps, and the part of the flight to learn from.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LapSettings {
    /// Length of a lap, s.
    pub lap_s: f64,
    /// Number of laps.
    pub laps: u32,
    /// Length of the newest part of the flight to learn from, s.
    pub newest_s: f64,
    /// Whether the first lap is planned with the vehicle file's physics.
    pub is_nominal_first: bool,
}

/// Elapsed time and CPU time.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Spent {
    /// Elapsed time on the wall clock.
    pub wall: Duration,
    /// CPU time of the thread.
    pub processor: Duration,
}

/// How the duration of learning is determined.
pub enum Pace {
    /// This constant, on the clock of the records.
    Stated(Duration),
    /// Measured with this stopwatch, whose origin is arbitrary.
    Measured(Box<dyn Fn() -> Spent + Send>),
}

/// Makes a planner, and the vehicle's response, from a learned model.
pub type Planning = Box<dyn Fn(&Learned) -> Result<(Planner, Answer), String> + Send>;

/// A learned model that does not fly yet.
struct Candidate {
    learned: Learned,
    /// Time of the last sample that it was learned from.
    last_sample: HostTime,
    /// Earliest time at which it is offered to the planner.
    ready: HostTime,
    stage: Stage,
    /// Time that learning took, as text.
    effort: String,
    /// Predicted RMS error of the next lap, m.
    foreseen_m: Option<f64>,
}

/// State of a candidate.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Stage {
    Ready,
    Offered,
    /// The planner accepted it as the model of this number.
    Taken(u64),
}

/// Learns a model after each lap and offers it to the planner.
pub struct LapLearner {
    settings: LapSettings,
    learner: InFlight,
    planning: Planning,
    exchange: Exchange,
    pace: Pace,
    collected: Collected,
    /// The present lap.
    on_course: Option<LapErrors>,
    laps: Vec<Lap>,
    prepared: Option<Prepared>,
    cuts: Vec<Cut>,
    candidate: Option<Candidate>,
    /// The learned model in use; `None` for the initial model, or after a withdrawal.
    present: Option<Learned>,
    /// Whether learning has stopped.
    is_over: bool,
    /// Name of the model in use, for events.
    model_name: String,
    foreseen_m: Option<f64>,
    pending_events: VecDeque<Record>,
}

impl LapLearner {
    /// Learns with `learner` from the records given to [`on_record`](Self::on_record). `planning`
    /// makes the planners to offer to `exchange`.
    pub fn new(
        settings: LapSettings,
        learner: InFlight,
        planning: Planning,
        exchange: Exchange,
        pace: Pace,
    ) -> Self {
        Self {
            settings,
            learner,
            planning,
            exchange,
            pace,
            collected: Collected::new(Duration::from_secs_f64(settings.newest_s)),
            on_course: None,
            laps: Vec::new(),
            prepared: None,
            cuts: Vec::new(),
            candidate: None,
            present: None,
            is_over: false,
            model_name: match settings.is_nominal_first {
                true => "the vehicle file's physics".to_owned(),
                false => "the initial model".to_owned(),
            },
            foreseen_m: None,
            pending_events: VecDeque::new(),
        }
    }

    /// Whether [`on_record`](Self::on_record) uses this record.
    pub fn uses(record: &Record) -> bool {
        matches!(record, Record::Frame(_) | Record::Tick(_) | Record::Facts(_))
    }

    /// Receives a record of the flight. If learning is due, it finishes before this returns.
    pub fn on_record(&mut self, record: &Record) {
        self.collected.take(record);
        if let Record::Tick(tick) = record {
            self.tick(tick);
        }
    }

    /// The next event for the log.
    pub fn take_event(&mut self) -> Option<Record> {
        self.pending_events.pop_front()
    }

    /// The laps flown so far.
    pub fn laps(&self) -> &[Lap] {
        &self.laps
    }

    fn tick(&mut self, tick: &Tick) {
        let now = tick.stamp.host;
        let time = tick.trajectory_time.filter(|_| tick.phase == ON_COURSE);
        let lap = time.map(|t| (t / self.settings.lap_s).max(0.0) as u32);
        let lap = lap.filter(|lap| *lap < self.settings.laps);
        if self.on_course.as_ref().is_some_and(|errors| Some(errors.number) != lap) {
            self.end_lap(now);
        }
        if let Some((lap, t)) = lap.zip(time) {
            let errors = self.on_course.get_or_insert_with(|| LapErrors::new(lap));
            if let Some(desired) = tick.desired {
                errors.add((tick.state.position - desired).norm());
            }
            let share = t / self.settings.lap_s - f64::from(lap);
            errors.share = share;
            if share >= PREPARED_AT && !errors.is_prepared {
                errors.is_prepared = true;
                if self.learns_after(lap + 1) {
                    self.prepare(now);
                }
            }
            if self.is_astray() {
                self.withdraw_astray(now);
            }
        }
        self.hand_over(tick);
    }

    /// Ends the current lap, and learns if another lap follows.
    fn end_lap(&mut self, now: HostTime) {
        let Some(errors) = self.on_course.take() else { return };
        let number = errors.number + 1;
        if errors.share < COMPLETE_SHARE {
            self.report(now, Severity::Info, format!("lap {number} is incomplete"));
            return;
        }
        let lap = errors.lap(self.model_name.clone(), self.foreseen_m.take());
        self.report(now, Severity::Info, lap.text());
        self.laps.push(lap);
        if self.learns_after(number) {
            self.learn(now);
        }
    }

    /// Whether to learn a model after this many laps.
    fn learns_after(&self, laps: u32) -> bool {
        laps < self.settings.laps && !self.is_over
    }

    /// Whether the current lap uses a learned model and its largest error exceeds [`WORSE`] times
    /// that of the previous lap by more than the noise of the estimate.
    fn is_astray(&self) -> bool {
        let lap = self.present.as_ref().zip(self.laps.last()).zip(self.on_course.as_ref());
        // While a new model is on its way, the exchange would withdraw that one.
        lap.filter(|_| self.candidate.is_none()).is_some_and(|((present, before), lap)| {
            lap.most_m > WORSE * before.most_m + present.held_out.noise_m()
        })
    }

    /// Goes back to the previous model and stops learning. The held-out samples had rated the
    /// withdrawn model better, so the samples cannot be trusted.
    fn withdraw_astray(&mut self, now: HostTime) {
        self.exchange.withdraw();
        self.is_over = true;
        (self.present, self.model_name) = (None, BEFORE_WITHDRAWN.to_owned());
        let text = "learned model withdrawn: the vehicle strays further from the course than in the \
                    previous lap although the model predicts better, so a sensor may be wrong; \
                    continuing with the previous model, without further learning";
        self.report(now, Severity::Warning, text.to_owned());
    }

    /// Runs the long searches on the flight so far, without the times that the audit excludes.
    fn prepare(&mut self, now: HostTime) {
        let flight = self.collected.flight("this flight");
        match self.audited(&flight).and_then(|()| {
            self.learner.prepare(flight, &self.cuts).map_err(|error| error.to_string())
        }) {
            Ok(prepared) => self.prepared = Some(prepared),
            Err(why) => {
                self.prepared = None;
                self.report(now, Severity::Warning, format!("cannot learn yet: {why}"));
            }
        }
    }

    fn audited(&mut self, flight: &Flight) -> Result<(), String> {
        let audit = Audit::of(flight);
        self.cuts = audit.cuts();
        match audit.fault_of_data() {
            Some(fault) => Err(fault.to_string()),
            None => Ok(()),
        }
    }

    fn learn(&mut self, now: HostTime) {
        let spent = |pace: &Pace| match pace {
            Pace::Stated(_) => Spent::default(),
            Pace::Measured(stopwatch) => stopwatch(),
        };
        let before = spent(&self.pace);
        if self.prepared.is_none() {
            // Preparation failed halfway through the lap, so learning takes longer now.
            self.prepare(now);
        }
        let Some(prepared) = self.prepared.take() else { return };
        let flight = self.collected.flight("this flight");
        let learned = self.learner.learn(flight, &self.cuts, &prepared, self.present.as_ref());
        let after = spent(&self.pace);
        match learned {
            Ok(learned) => {
                let (ready, effort) = match &self.pace {
                    Pace::Stated(latency) => {
                        (now + *latency, format!("{:.2} s (stated)", latency.as_secs_f64()))
                    }
                    Pace::Measured(_) => {
                        let wall_s = after.wall.saturating_sub(before.wall).as_secs_f64();
                        let own = after.processor.saturating_sub(before.processor);
                        let own_s = own.as_secs_f64();
                        (now, format!("{wall_s:.2} s ({own_s:.2} s of CPU time)"))
                    }
                };
                let foreseen_m = self.foreseen_m(&learned);
                self.report(now, Severity::Info, lap_text(&learned, &effort));
                let (last_sample, stage) = (now, Stage::Ready);
                self.candidate =
                    Some(Candidate { learned, last_sample, ready, stage, effort, foreseen_m });
            }
            Err(why) => self.discard(now, &why),
        }
    }

    /// RMS error of the next lap, m, if it is proportional to the prediction error after half a
    /// second. The first lap, planned with the vehicle file's physics, gives the factor.
    fn foreseen_m(&self, learned: &Learned) -> Option<f64> {
        let first = self.laps.first().filter(|_| self.settings.is_nominal_first)?;
        let ratio = learned.held_out.position_m() / learned.nominal.position_m();
        ratio.is_finite().then(|| (first.rms_m * ratio).hypot(learned.held_out.noise_m()))
    }

    fn discard(&mut self, now: HostTime, why: &Discarded) {
        let model_name = &self.model_name;
        let text = format!("learned model discarded: {why}; continuing with {model_name}");
        // Expected once noise limits the laps.
        let is_expected = matches!(why, Discarded::NoBetter { .. });
        let severity = if is_expected { Severity::Info } else { Severity::Warning };
        self.report(now, severity, text);
    }

    /// Offers a candidate that is ready, and tracks it until its first setpoint.
    fn hand_over(&mut self, tick: &Tick) {
        let now = tick.stamp.host;
        let verdict = self.exchange.take_verdict();
        let mut candidate = match self.candidate.take() {
            Some(candidate) if candidate.stage != Stage::Ready || now >= candidate.ready => {
                candidate
            }
            waiting => {
                self.candidate = waiting;
                if let Some(Verdict::Refused { reason }) = verdict {
                    // Plans with an accepted model may fail later.
                    self.withdraw(now, &reason);
                }
                return;
            }
        };
        if candidate.stage == Stage::Ready {
            if let Some(Verdict::Refused { reason }) = verdict {
                self.withdraw(now, &reason);
            }
            match (self.planning)(&candidate.learned) {
                Ok((planner, answer)) => self.exchange.offer(planner, answer),
                Err(why) => return self.refuse(now, &why),
            }
            candidate.stage = Stage::Offered;
            self.candidate = Some(candidate);
            return;
        }
        match verdict {
            Some(Verdict::Refused { reason }) => return self.refuse(now, &reason),
            Some(Verdict::Taken { model }) => candidate.stage = Stage::Taken(model),
            None => {}
        }
        let Stage::Taken(model) = candidate.stage else {
            self.candidate = Some(candidate);
            return;
        };
        // The tick of that time may arrive after the verdict.
        let is_used = self.exchange.used_from_s(model).zip(tick.trajectory_time);
        if is_used.is_none_or(|(from_s, time)| time < from_s) || tick.setpoint.is_none() {
            self.candidate = Some(candidate);
            return;
        }
        let latency_s = now.since(candidate.last_sample).as_secs_f64();
        let lap = self.laps.len() + 1;
        self.model_name = format!(
            "the model learned in {} from {:.0} s of flight",
            candidate.effort, candidate.learned.flown_s
        );
        let text = format!(
            "lap {lap} now uses {}: first setpoint {latency_s:.3} s after the last sample",
            self.model_name
        );
        self.report(now, Severity::Info, text);
        self.foreseen_m = candidate.foreseen_m;
        self.present = Some(candidate.learned);
    }

    /// Records that plans with the current model failed and the planner went back to the previous
    /// one.
    fn withdraw(&mut self, now: HostTime, why: &str) {
        self.refuse(now, why);
        (self.present, self.model_name) = (None, BEFORE_WITHDRAWN.to_owned());
    }

    fn refuse(&mut self, now: HostTime, why: &str) {
        let text = format!(
            "learned model discarded: no flyable plan with it: {why}; continuing with the previous \
             model"
        );
        self.report(now, Severity::Warning, text);
    }

    fn report(&mut self, host: HostTime, severity: Severity, text: String) {
        self.pending_events.push_back(Record::Event {
            host,
            severity,
            source: Source::Daemon,
            text,
        });
    }
}

/// Describes a learned model's errors, and what limits the next lap.
fn lap_text(learned: &Learned, effort: &str) -> String {
    let Learned { held_out, nominal, flown_s, .. } = learned;
    let HeldOutErrors { residual_m_s2, lasting_m_s2, .. } = *held_out;
    let limit = if lasting_m_s2.powi(2) > LASTING_SHARE * residual_m_s2.powi(2) {
        "the model limits the next lap"
    } else {
        "noise limits the next lap"
    };
    format!(
        "learned in {effort} from {flown_s:.0} s of flight: held-out position error {:.4} m after {} s (vehicle \
         file's physics {:.4} m, noise of the estimate {:.4} m); RMS residual {residual_m_s2:.3} m/s^2, its \
         persistent part {lasting_m_s2:.3} m/s^2 (vehicle file's physics {:.3} m/s^2): {limit}",
        held_out.position_m(),
        HeldOutErrors::AFTER_S,
        nominal.position_m(),
        held_out.noise_m(),
        nominal.lasting_m_s2,
    )
}

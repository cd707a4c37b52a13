//! A flight in laps that learns from lap to lap: its course and its learner.

use std::num::NonZeroU32;
use std::sync::Arc;
use std::sync::mpsc::{Receiver, Sender, SyncSender, TrySendError, channel, sync_channel};
use std::time::{Duration, Instant};

use anyhow::{Context, anyhow};
use rustix::time::{ClockId, clock_gettime};

use super::course::Course;
use super::plan::{PlanModel, planner};
use super::vehicle_file::VehicleFile;
use super::{Exit, ExitContext, error_text};
use crate::cli::LearnArgs;
use crate::config::Config;
use crate::lap_learning::{LapLearner, LapSettings, Pace, Planning, Spent};
use crate::learn::in_flight::{InFlight, Learned};
use crate::log::record::Record;
use crate::log::sink::Listener;
use crate::plan::Trajectory;
use crate::plan::planned::PlannedThrough;
use crate::plan::receding::RecedingReference;

/// Default number of laps.
const LAPS: NonZeroU32 = NonZeroU32::new(4).expect("not zero");
/// Allowed length of the part of the flight to learn from, s.
const SECONDS: std::ops::RangeInclusive<f64> = 15.0..=600.0;
/// Records queued while a model is being learned: about ten seconds of a fast link.
const QUEUE: usize = 16_384;

/// The clock of planning and learning.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Clock {
    /// The wall clock, with planning and learning in separate threads.
    Wall,
    /// The simulation's clock, in one thread: planning takes no time, learning `learning_s`.
    Virtual { learning_s: f64 },
}

/// Makes laps of a trajectory, planned in flight, and their learner. The first lap is planned with
/// the model `plan_model`.
pub(super) fn lap_course(
    args: &LearnArgs,
    lap: Trajectory,
    plan_model: &PlanModel,
    vehicle: &VehicleFile,
    config: &Config,
    clock: Clock,
) -> anyhow::Result<(Course, LapLearner)> {
    let newest_s = args.learn.unwrap_or_default();
    if !SECONDS.contains(&newest_s) {
        let (least, most) = SECONDS.into_inner();
        return Err(anyhow!("--learn: expected {least} to {most} s, found {newest_s}"))
            .or_exit(Exit::Usage);
    }
    let laps = args.laps.unwrap_or(LAPS).get();
    let is_nominal_first = plan_model.is_nominal();
    let settings = LapSettings { lap_s: lap.duration(), laps, newest_s, is_nominal_first };
    let goal = lap.laps(laps).or_exit(Exit::Usage)?;
    let params = &vehicle.params;
    let (first, answer) = planner(params, plan_model, config)?;
    // Cautious for any attitude loop: a plan that starts afresh from each estimate hides the
    // model's errors from the laps and follows the noise of the estimate.
    let receding = config.settings.plan.receding.for_loop(true);
    let (reference, pace) = match clock {
        Clock::Wall => {
            let reference = RecedingReference::threaded(goal.clone(), first, answer, receding)
                .context("cannot start the planning thread")?;
            (reference, Pace::Measured(stopwatch()))
        }
        Clock::Virtual { learning_s } => {
            let latency = Duration::try_from_secs_f64(learning_s)
                .context("learn.simulated_latency_s")
                .or_exit(Exit::Usage)?;
            let reference = RecedingReference::inline(goal.clone(), first, answer, receding);
            (reference, Pace::Stated(latency))
        }
    };
    let (exchange, reference) = (reference.exchange(), Arc::new(reference));
    let course = Course::Receding { goal, reference };
    course.check(vehicle, config)?;
    let learner = InFlight::new(params.clone()).or_exit(Exit::Usage)?;
    let planning = planning(vehicle, config);
    Ok((course, LapLearner::new(settings, learner, planning, exchange, pace)))
}

/// As [`lap_course`] for a simulated flight, first with the vehicle file's physics.
pub(super) fn simulated(
    args: &LearnArgs,
    course: &Course,
    vehicle: &VehicleFile,
    config: &Config,
) -> anyhow::Result<(Course, LapLearner)> {
    let Course::Desired(lap) = course.clone() else {
        return Err(anyhow!(
            "--learn: expected a trajectory, found a plan; give the trajectory file"
        ))
        .or_exit(Exit::Usage);
    };
    let plan_model = PlanModel::nominal(&vehicle.params)?;
    let learning_s = config.settings.learn.simulated_latency_s;
    lap_course(args, lap, &plan_model, vehicle, config, Clock::Virtual { learning_s })
}

/// Returns a function that makes the vehicle's planner from a learned model.
fn planning(vehicle: &VehicleFile, config: &Config) -> Planning {
    let (params, config) = (vehicle.params.clone(), config.clone());
    Box::new(move |learned: &Learned| {
        let note = PlannedThrough { kind: "learned in flight".to_owned(), sha256: None };
        let model = Arc::new(learned.model.clone());
        PlanModel::of(model, &learned.actuation, &params, note)
            .and_then(|plan_model| planner(&params, &plan_model, &config))
            .map_err(|error| error_text(&error))
    })
}

/// Measures elapsed time and the CPU time of the calling thread.
fn stopwatch() -> Box<dyn Fn() -> Spent + Send> {
    let began = Instant::now();
    Box::new(move || {
        let own = clock_gettime(ClockId::ThreadCPUTime);
        let seconds = own.tv_sec.try_into().unwrap_or(0);
        let processor = Duration::new(seconds, own.tv_nsec.try_into().unwrap_or(0));
        Spent { wall: began.elapsed(), processor }
    })
}

/// A listener in the log's thread that queues a flight's records for the learner's thread.
pub(super) struct RecordQueue {
    queue: SyncSender<Record>,
    events: Receiver<Record>,
}

/// Messages of a learner for the terminal.
pub(super) type Lines = Receiver<String>;

/// Starts the learner's thread, which uses at most one core and ends when the
/// [`RecordQueue`] is dropped.
pub(super) fn start(mut learner: LapLearner) -> anyhow::Result<(RecordQueue, Lines)> {
    let (queue, records) = sync_channel(QUEUE);
    let (events, received) = channel();
    let (lines, output) = channel();
    // One thread: the control line and the planner keep the other cores.
    let pool = rayon::ThreadPoolBuilder::new()
        .num_threads(1)
        .thread_name(|_| "learning".to_owned())
        .build()
        .context("cannot start the learning thread")?;
    // The task outlives the pool: a dropped pool finishes what was spawned.
    pool.spawn(move || attend(&mut learner, &records, &events, &lines));
    Ok((RecordQueue { queue, events: received }, output))
}

fn attend(
    learner: &mut LapLearner,
    records: &Receiver<Record>,
    events: &Sender<Record>,
    lines: &Sender<String>,
) {
    while let Ok(record) = records.recv() {
        learner.on_record(&record);
        while let Some(event) = learner.take_event() {
            if let Record::Event { text, .. } = &event {
                // The receiver may be gone.
                let _ = lines.send(text.clone());
            }
            let _ = events.send(event);
        }
    }
}

impl Listener for RecordQueue {
    fn on_record(&mut self, record: &Record) {
        if LapLearner::uses(record) {
            // A full queue leaves a gap in the samples.
            match self.queue.try_send(record.clone()) {
                Ok(()) | Err(TrySendError::Full(_) | TrySendError::Disconnected(_)) => {}
            }
        }
    }

    fn remark(&mut self) -> Option<Record> {
        self.events.try_recv().ok()
    }
}

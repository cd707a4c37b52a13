//! Unannounced changes in flight under each form of feedback: the error before, its peak, the time
//! until it matches an oracle's, and the number of lost flights.
//!
//! `cargo bench --bench adapt -- [--draws 40] [--seed 1] [--vehicle quad1200] [--course hover]
//! [--change payload] [--feedback lqr+adaptive] [--windows] [--words]`
//!
//! The flights are in the bundled simulator, in lockstep. Each draw has its own noise, time,
//! direction and rotor, the same for every feedback. The oracle is `lqr+adaptive` in the same draw,
//! with the change present since the start of the trajectory: it has already adapted when the
//! others meet the change.

mod change;
mod feedback;
mod flight;
mod table;

use change::Change;
use feedback::Feedback;
use flight::{Course, Draw};

struct Options {
    draws: u64,
    seed: u64,
    vehicle: String,
    course: Course,
    changes: Vec<Change>,
    feedbacks: Vec<Feedback>,
    /// Prints the messages of the adaptation in the first draw.
    words: bool,
    /// Prints the error of every window.
    windows: bool,
}

fn options() -> Options {
    let mut options = Options {
        draws: 40,
        seed: 1,
        vehicle: "quad1200".to_owned(),
        course: Course::Hover,
        changes: Vec::new(),
        feedbacks: Vec::new(),
        words: false,
        windows: false,
    };
    let mut args = std::env::args().skip(1);
    while let Some(arg) = args.next() {
        let mut value = || args.next().unwrap_or_else(|| panic!("{arg}: expected a value"));
        match arg.as_str() {
            "--draws" => options.draws = value().parse().expect("a number of draws"),
            "--seed" => options.seed = value().parse().expect("a seed"),
            "--vehicle" => options.vehicle = value(),
            "--course" => options.course = Course::named(&value()).expect("hover or circle"),
            "--change" => options.changes.push(Change::named(&value()).expect("a change")),
            "--feedback" => {
                options.feedbacks.push(Feedback::named(&value()).expect("a feedback"));
            }
            "--windows" => options.windows = true,
            "--words" => options.words = true,
            "--bench" => {} // cargo adds it
            other => panic!("unknown flag {other}"),
        }
    }
    if options.changes.is_empty() {
        options.changes = Change::ALL.to_vec();
    }
    if options.feedbacks.is_empty() {
        options.feedbacks = Feedback::ALL.to_vec();
    }
    options
}

fn main() {
    let options = options();
    println!("{}, {}, {} draws", options.vehicle, options.course.name(), options.draws);
    table::head();
    for change in &options.changes {
        let draws: Vec<Draw> =
            (0..options.draws).map(|draw| Draw::new(options.seed, draw)).collect();
        let fly = |feedback: &Feedback, since_start: bool| {
            flight::fly_all(
                &options.vehicle,
                options.course,
                *change,
                feedback,
                &draws,
                since_start,
            )
        };
        let oracle = fly(&Feedback::ORACLE, true);
        for feedback in &options.feedbacks {
            let flown = fly(feedback, false);
            table::row(*change, feedback, &flown, &oracle);
            if options.windows {
                table::windows_of(&flown, &oracle);
            }
            if options.words {
                flown
                    .iter()
                    .take(1)
                    .flat_map(|flown| &flown.words)
                    .for_each(|w| println!("    {w}"));
            }
        }
        table::row(*change, &Feedback::named_oracle(), &oracle, &oracle);
    }
}

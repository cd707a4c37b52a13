//! Training of a network, from outside: what it learns, when it stops; neither threads nor an
//! interruption change a bit.

use std::ops::ControlFlow;

use downwash::learn::samples::Samples;
use downwash::learn::training::{
    Checkpoint, Method, Pass, Settings, Stop, Training, TrainingError, mean_squared_error, train,
};

const METHODS: [Method; 2] = [Method::Rprop, Method::Adam];

/// Two smooth outputs of three inputs that lie around the origin like normalised ones.
fn known_function(rows: usize, first: usize) -> Samples {
    let mut samples = Samples::with_capacity(3, 2, rows);
    for row in first..first + rows {
        // A low-discrepancy sequence: fills the cube evenly without a generator.
        let x = [0.618_034, 0.754_878, 0.819_173].map(|step| {
            let place = (row as f64 * step).fract();
            3.4 * (place - 0.5)
        });
        let targets = [(x[0] * x[1]).sin(), x[2].abs() - 0.5 * x[0]];
        let narrow = |value: f64| value as f32;
        samples.push(&x.map(narrow), &targets.map(narrow)).expect("finite values");
    }
    samples
}

fn settings(method: Method) -> Settings {
    Settings { hidden: 20, passes: 30, method, ..Settings::default() }
}

fn run(settings: &Settings, sets: &[Samples; 2]) -> Training {
    train(&sets[0], &sets[1], settings, None, |_, _| ControlFlow::Continue(())).expect("a training")
}

fn sets() -> [Samples; 2] {
    [known_function(3000, 0), known_function(700, 10_000)]
}

fn lowest(training: &Training) -> f64 {
    training.curve.iter().filter_map(|pass| pass.validation).fold(f64::INFINITY, f64::min)
}

#[test]
fn loss_of_a_known_function_falls_on_unseen_rows() {
    let sets = sets();
    let targets_variance = 0.5; // about that of both outputs
    for (method, at_most) in [(Method::Rprop, 0.05), (Method::Adam, 0.03)] {
        let settings = Settings { passes: 150, patience: 150, ..settings(method) };
        let training = run(&settings, &sets);
        assert_eq!(training.stop, Stop::Passes);
        assert_eq!(training.curve.len(), 150);
        let test = mean_squared_error(&training.network, &known_function(500, 50_000));
        assert!(test < at_most * targets_variance, "{method:?}: {test}");
    }
}

#[test]
fn returned_network_is_the_best_on_validation() {
    let sets = sets();
    for method in METHODS {
        let training = run(&settings(method), &sets);
        let found = mean_squared_error(&training.network, &sets[1]);
        assert_eq!(found.to_bits(), lowest(&training).to_bits());
    }
}

#[test]
fn validation_runs_at_its_interval_and_at_the_end() {
    let settings = Settings { passes: 12, validation_interval: 5, ..settings(Method::Rprop) };
    let training = run(&settings, &sets());
    let looked: Vec<usize> =
        training.curve.iter().filter(|pass| pass.validation.is_some()).map(|p| p.number).collect();
    assert_eq!(looked, [5, 10, 12]);
}

#[test]
fn thread_count_does_not_change_a_bit() {
    let sets = [known_function(9000, 0), known_function(3000, 10_000)];
    for method in METHODS {
        let settings = Settings { passes: 6, ..settings(method) };
        let with = |threads| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build();
            pool.expect("threads").install(|| run(&settings, &sets))
        };
        let one = with(1);
        assert_eq!(one, with(2));
        assert_eq!(one, with(3));
        let side_by_side = rayon::join(|| run(&settings, &sets), || run(&settings, &sets));
        assert_eq!((&one, &one), (&side_by_side.0, &side_by_side.1));
    }
}

#[test]
fn seed_determines_the_training() {
    let sets = sets();
    for method in METHODS {
        let settings = Settings { passes: 3, ..settings(method) };
        assert_eq!(run(&settings, &sets), run(&settings, &sets));
        let other = Settings { seed: 2, ..settings.clone() };
        assert_ne!(run(&settings, &sets).network, run(&other, &sets).network);
    }
}

/// A training stopped after `passes`, and its checkpoint read back from JSON.
fn interrupted(settings: &Settings, sets: &[Samples; 2], passes: usize) -> (Training, Checkpoint) {
    let mut written = String::new();
    let training = train(&sets[0], &sets[1], settings, None, |pass: &Pass, trainer| {
        if pass.number < passes {
            return ControlFlow::Continue(());
        }
        written = serde_json::to_string(trainer.checkpoint()).expect("JSON");
        ControlFlow::Break(())
    });
    (training.expect("a training"), serde_json::from_str(&written).expect("a checkpoint"))
}

#[test]
fn interrupted_training_resumes_to_the_same_result() {
    let sets = sets();
    for method in METHODS {
        let settings = settings(method);
        let whole = run(&settings, &sets);
        for passes in [1, 7, 10, 29] {
            let (part, checkpoint) = interrupted(&settings, &sets, passes);
            assert_eq!(part.stop, Stop::Interrupted);
            assert_eq!(part.curve, whole.curve[..passes]);
            let resumed = train(&sets[0], &sets[1], &settings, Some(checkpoint), |_, _| {
                ControlFlow::Continue(())
            });
            assert_eq!(resumed.expect("a training"), whole, "{method:?} after {passes}");
        }
    }
}

#[test]
fn checkpoint_of_another_training_is_refused() {
    let sets = sets();
    let settings = settings(Method::Rprop);
    let (_, checkpoint) = interrupted(&settings, &sets, 2);
    let resume = |settings: &Settings, training: &Samples| {
        let checkpoint = Some(checkpoint.clone());
        train(training, &sets[1], settings, checkpoint, |_, _| ControlFlow::Break(()))
            .expect_err("another training")
            .to_string()
    };
    let more = Settings { hidden: 21, ..settings.clone() };
    assert!(resume(&more, &sets[0]).contains("the settings differ"));
    let other = Settings { method: Method::Adam, ..settings.clone() };
    assert!(resume(&other, &sets[0]).contains("the method differs"));
    assert!(resume(&settings, &known_function(3000, 1)).contains("the rows differ"));
}

#[test]
fn regularization_keeps_the_parameters_small() {
    let sets = sets();
    let size = |network: &downwash::model::net::Mlp| -> f32 {
        let weights = network.hidden_weights.iter().chain(&network.output_weights);
        weights.map(|weight| weight * weight).sum()
    };
    for method in METHODS {
        let free = run(&settings(method), &sets);
        let held = run(&Settings { regularization: 0.95, ..settings(method) }, &sets);
        let (held_size, free_size) = (size(&held.network), size(&free.network));
        assert!(held_size < 0.8 * free_size, "{method:?}: {held_size} and {free_size}");
        assert!(lowest(&held) > lowest(&free), "{method:?}");
    }
}

#[test]
fn training_stops_early_without_improvement() {
    // Pure noise: what is learned from these rows is wrong for the others.
    let noise = |seed: u64| {
        let mut state = seed;
        let mut next = || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
            (state >> 40) as f32 / 8_388_608.0 - 1.0
        };
        let mut samples = Samples::with_capacity(4, 1, 60);
        for _ in 0..60 {
            let inputs = [next(), next(), next(), next()];
            samples.push(&inputs, &[next()]).expect("finite values");
        }
        samples
    };
    let sets = [noise(1), noise(2)];
    let settings =
        Settings { passes: 2000, validation_interval: 1, patience: 25, ..settings(Method::Rprop) };
    let training = run(&settings, &sets);
    assert_eq!(training.stop, Stop::Patience);
    let best = training.curve.iter().rposition(|pass| pass.best).expect("a best pass");
    assert_eq!(training.curve.len(), best + 1 + 25);
    let found = mean_squared_error(&training.network, &sets[1]);
    assert_eq!(Some(found), training.curve[best].validation);
}

#[test]
fn invalid_training_inputs_are_refused() {
    let sets = sets();
    let empty = Samples::with_capacity(3, 2, 0);
    let refused = |training: &Samples, validation: &Samples, settings: &Settings| {
        train(training, validation, settings, None, |_, _| ControlFlow::Continue(()))
            .expect_err("refused")
    };
    let usual = settings(Method::Rprop);
    assert_eq!(refused(&sets[0], &empty, &usual), TrainingError::Empty("validation"));
    assert_eq!(refused(&empty, &sets[1], &usual), TrainingError::Empty("training"));
    let mut narrow = Samples::with_capacity(1, 2, 1);
    narrow.push(&[1.0], &[1.0, 2.0]).expect("a row");
    assert!(matches!(refused(&sets[0], &narrow, &usual), TrainingError::Columns { .. }));
    for settings in [
        Settings { hidden: 0, ..usual.clone() },
        Settings { validation_interval: 0, ..usual.clone() },
        Settings { regularization: 1.0, ..usual.clone() },
        Settings { regularization: f64::NAN, ..usual.clone() },
    ] {
        assert!(matches!(refused(&sets[0], &sets[1], &settings), TrainingError::Range { .. }));
    }
}

#[test]
fn overflowing_values_end_the_training_as_diverged() {
    let mut samples = Samples::with_capacity(1, 1, 1);
    samples.push(&[1e30], &[-1e30]).expect("finite values");
    let training = run(&settings(Method::Rprop), &[samples.clone(), samples]);
    assert_eq!(training.stop, Stop::Diverged);
}

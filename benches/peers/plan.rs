//! The planning problem given to the other solvers, with wrenches as inputs: cold, from the desired
//! states and hover, and again from a plan whose start has moved.
//!
//! `cargo bench --bench plan -- [--problem DIR] [--repeats 5] [--model NAME] [--out DIR] [--json]`
//!
//! DIR holds `params.json`, `nets.json` and `traj_sinyawN.json`; by default it is
//! `$DOWNWASH_PEERS_PROBLEM`, else `../shared/peers/problem` beside the repository. If it is
//! missing, nothing is measured. With `--out`, plans are written as `{"S": states, "U": inputs}`.

use std::path::{Path, PathBuf};
use std::time::Instant;

use downwash::model::features::Features;
use downwash::model::learned::{Network, NetworkModel};
use downwash::model::net::{Mlp, Normalization};
use downwash::model::{ACCELERATIONS, Jacobian, Model, Point, VARIABLES};
use downwash::plan::discretisation::WrenchDynamics;
use downwash::plan::interior_point::InteriorPoint;
use downwash::plan::iterate::Iterate;
use downwash::plan::problem::{InputBounds, Problem, STATES, StateLimits, StateVector};
use downwash::plan::scp::{Outcome, ScpSettings, search};
use rand::{Rng, SeedableRng};
use rand_pcg::Pcg64Mcg;
use serde::Deserialize;
use serde::de::DeserializeOwned;
use vehicle::scalar::{Dual, Scalar};

#[derive(Deserialize)]
struct Params {
    mass: f64,
    gravity: f64,
    inertia: [f64; 3],
    drag_body: [f64; 3],
    ang_drag: [f64; 3],
    u_min: [f64; 4],
    u_max: [f64; 4],
    u_hover: [f64; 4],
    u_scale: [f64; 4],
}

#[derive(Deserialize)]
struct Course {
    dt: f64,
    s0: StateVector,
    sd: Vec<StateVector>,
}

#[derive(Deserialize)]
struct Nets {
    nn1: Net,
    nn2: Net,
}

#[derive(Deserialize)]
#[allow(non_snake_case, reason = "the names in the file")]
struct Net {
    in_mean: Vec<f64>,
    in_std: Vec<f64>,
    out_mean: Vec<f64>,
    out_std: Vec<f64>,
    W1: Vec<Vec<f32>>,
    b1: Vec<f32>,
    W2: Vec<Vec<f32>>,
    b2: Vec<f32>,
}

impl From<Net> for Network {
    fn from(net: Net) -> Self {
        Self {
            mlp: Mlp {
                inputs: net.in_mean.len(),
                hidden: net.b1.len(),
                outputs: net.b2.len(),
                hidden_weights: net.W1.concat(),
                hidden_biases: net.b1,
                output_weights: net.W2.concat(),
                output_biases: net.b2,
            },
            inputs: Normalization { mean: net.in_mean, deviation: net.in_std },
            outputs: Normalization { mean: net.out_mean, deviation: net.out_std },
        }
    }
}

/// A quadrotor with drag linear in the body's velocity and rate.
impl Params {
    fn evaluate<T: Scalar>(&self, at: &[T; VARIABLES]) -> [T; ACCELERATIONS] {
        let [vn, ve, vd, p, q, r, roll, pitch, yaw, thrust, mx, my, mz] = *at;
        let ((sr, cr), (sp, cp), (sy, cy)) = (roll.sin_cos(), pitch.sin_cos(), yaw.sin_cos());
        // Columns: the body's axes in the world.
        let axes = [
            [cp * cy, cp * sy, -sp],
            [sr * sp * cy - cr * sy, sr * sp * sy + cr * cy, sr * cp],
            [cr * sp * cy + sr * sy, cr * sp * sy - sr * cy, cr * cp],
        ];
        let mut linear = [T::default(), T::default(), T::default()];
        for (axis, drag) in axes.iter().zip(self.drag_body) {
            let speed = axis[0] * vn + axis[1] * ve + axis[2] * vd;
            for (sum, along) in linear.iter_mut().zip(axis) {
                *sum -= *along * speed * (drag / self.mass);
            }
        }
        for (sum, along) in linear.iter_mut().zip(&axes[2]) {
            *sum -= *along * thrust * (1.0 / self.mass);
        }
        let [jx, jy, jz] = self.inertia;
        let angular = |moment: T, rate: T, gyroscopic: T, across: f64, axis: usize| {
            (moment - rate * self.ang_drag[axis] - gyroscopic * across) * (1.0 / self.inertia[axis])
        };
        [
            linear[0],
            linear[1],
            linear[2] + self.gravity,
            angular(mx, p, q * r, jz - jy, 0),
            angular(my, q, r * p, jx - jz, 1),
            angular(mz, r, p * q, jy - jx, 2),
        ]
    }
}

impl Model for Params {
    fn accelerations(&self, at: &Point) -> [f64; ACCELERATIONS] {
        self.evaluate(&at.to_array())
    }

    fn linearize(&self, at: &Point) -> ([f64; ACCELERATIONS], Jacobian) {
        let at = at.to_array();
        let duals: [Dual<VARIABLES>; VARIABLES] = std::array::from_fn(|i| Dual::variable(at[i], i));
        let value = self.evaluate(&duals);
        (value.map(|dual| dual.value()), value.map(|dual| *dual.gradient()))
    }
}

/// The physics with networks on top.
struct Hybrid<'a>(&'a Params, NetworkModel);

impl Model for Hybrid<'_> {
    fn accelerations(&self, at: &Point) -> [f64; ACCELERATIONS] {
        let (physics, residual) = (self.0.accelerations(at), self.1.accelerations(at));
        std::array::from_fn(|i| physics[i] + residual[i])
    }

    fn linearize(&self, at: &Point) -> ([f64; ACCELERATIONS], Jacobian) {
        let ((mut value, mut jacobian), (correction, slopes)) =
            (self.0.linearize(at), self.1.linearize(at));
        for row in 0..ACCELERATIONS {
            value[row] += correction[row];
            for (sum, slope) in jacobian[row].iter_mut().zip(slopes[row]) {
                *sum += slope;
            }
        }
        (value, jacobian)
    }
}

/// Networks of the same size and normalisation with random weights, whose accelerations are a few
/// per cent of those of `nets`.
fn residual(nets: &NetworkModel) -> NetworkModel {
    let mut random = Pcg64Mcg::seed_from_u64(7);
    let mut redraw = |network: &Network| {
        let mut network = network.clone();
        let Mlp { hidden_weights, hidden_biases, output_weights, .. } = &mut network.mlp;
        for (weights, size) in [(hidden_weights, 0.3), (hidden_biases, 0.5), (output_weights, 0.02)]
        {
            weights.iter_mut().for_each(|weight| *weight = random.random_range(-size..size));
        }
        network.mlp.output_biases.fill(0.0);
        network.outputs.mean.fill(0.0);
        network
    };
    NetworkModel {
        features: nets.features,
        linear: redraw(&nets.linear),
        angular: redraw(&nets.angular),
    }
}

struct Options {
    problem: PathBuf,
    repeats: usize,
    model: Option<String>,
    out: Option<PathBuf>,
    json: bool,
}

fn options() -> Options {
    let beside = Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared/peers/problem");
    let problem = std::env::var_os("DOWNWASH_PEERS_PROBLEM").map_or(beside, PathBuf::from);
    let mut options = Options { problem, repeats: 5, model: None, out: None, json: false };
    let mut args = std::env::args().skip(1);
    while let Some(arg) = args.next() {
        let mut value = || args.next().unwrap_or_else(|| panic!("{arg}: expected a value"));
        match arg.as_str() {
            "--problem" => options.problem = value().into(),
            "--repeats" => options.repeats = value().parse().expect("a number of repeats"),
            "--model" => options.model = Some(value()),
            "--out" => options.out = Some(value().into()),
            "--json" => options.json = true,
            "--bench" => {} // cargo adds it
            other => panic!("unknown flag {other}"),
        }
    }
    options
}

fn read<T: DeserializeOwned>(folder: &Path, name: &str) -> T {
    let path = folder.join(format!("{name}.json"));
    let text = std::fs::read(&path).unwrap_or_else(|error| panic!("{}: {error}", path.display()));
    serde_json::from_slice(&text).unwrap_or_else(|error| panic!("{}: {error}", path.display()))
}

/// One search `repeats` times: its outcome, and the sorted times in s.
fn timed(
    problem: &Problem<4>,
    dynamics: &WrenchDynamics<'_>,
    settings: &ScpSettings,
    guess: &Iterate<4>,
    repeats: usize,
) -> (Outcome<4>, Vec<f64>) {
    let once = || {
        let guess = guess.clone();
        let start = Instant::now();
        let mut solver = InteriorPoint::default();
        let outcome = search(problem, dynamics, &mut solver, settings, guess, &|_| false);
        (outcome, start.elapsed().as_secs_f64())
    };
    let (outcome, first) = once();
    let mut seconds = vec![first];
    seconds.extend((1..repeats).map(|_| once().1));
    seconds.sort_by(f64::total_cmp);
    (outcome, seconds)
}

fn print(options: &Options, name: &str, start: &str, outcome: &Outcome<4>, seconds: &[f64]) {
    let (periods, subproblems) = (outcome.iterate.inputs.len(), outcome.records.len());
    let iterations: usize = outcome.records.iter().map(|record| record.solver_iterations).sum();
    let (median, least) = (seconds[seconds.len() / 2], seconds[0]);
    if options.json {
        let line = serde_json::json!({
            "tool": "downwash", "model": name, "periods": periods, "start": start,
            "seconds": median, "least_s": least, "cost": outcome.cost,
            "defect": outcome.violation.defect, "subproblems": subproblems,
            "iterations": iterations, "status": outcome.status,
        });
        println!("{line}");
    } else {
        println!(
            "{name:8} {start:5} {periods:5} {:9.2} {:9.2} {:11.5} {:9.1e} {subproblems:5} \
             {iterations:6}  {}",
            1e3 * median,
            1e3 * least,
            outcome.cost,
            outcome.violation.defect,
            outcome.status.text()
        );
    }
}

fn write(options: &Options, name: &str, start: &str, outcome: &Outcome<4>) {
    let Some(folder) = &options.out else { return };
    let Iterate { states, inputs } = &outcome.iterate;
    std::fs::create_dir_all(folder).expect("a folder");
    let path = folder.join(format!("sinyaw{}_{name}_{start}.json", inputs.len()));
    let text = serde_json::json!({ "S": states, "U": inputs }).to_string();
    std::fs::write(&path, text).unwrap_or_else(|error| panic!("{}: {error}", path.display()));
}

fn main() {
    let options = options();
    if !options.problem.join("params.json").is_file() {
        eprintln!(
            "skipped: no params.json in {}; name the folder with --problem",
            options.problem.display()
        );
        return;
    }
    let physics: Params = read(&options.problem, "params");
    let Nets { nn1, nn2 } = read(&options.problem, "nets");
    let nets = NetworkModel { features: Features::World, linear: nn1.into(), angular: nn2.into() };
    let hybrid = Hybrid(&physics, residual(&nets));
    let cold = ScpSettings::default();
    // A plan already exists: small steps, and an end once they gain little.
    let near = ScpSettings { trust: 0.1, progress: 1e-2, ..cold };
    let models: [(&str, &dyn Model); 3] =
        [("physics", &physics), ("nets", &nets), ("hybrid", &hybrid)];
    if !options.json {
        println!("model    start     N median ms  least ms        cost    defect  subp.  inner");
    }
    for (name, model) in models {
        if options.model.as_deref().is_some_and(|only| only != name) {
            continue;
        }
        for periods in [100, 300, 1000] {
            let course: Course = read(&options.problem, &format!("traj_sinyaw{periods}"));
            let mut problem = Problem {
                period_s: course.dt,
                start: course.s0,
                desired: course.sd[1..].to_vec(),
                state_weight: [1.0; STATES],
                knee: 0.0,
                inputs: InputBounds {
                    lower: physics.u_min,
                    upper: physics.u_max,
                    scale: physics.u_scale,
                },
                preference: None,
                limits: StateLimits::default(),
                keep_out: vec![],
                margin_m: vec![],
            };
            let dynamics = WrenchDynamics::new(model, course.dt);
            let guess = Iterate::desired(&problem, physics.u_hover);
            let (outcome, seconds) = timed(&problem, &dynamics, &cold, &guess, options.repeats);
            print(&options, name, "cold", &outcome, &seconds);
            write(&options, name, "cold", &outcome);
            // The vehicle is 2 cm, 5 cm/s and 0.02 rad off its plan.
            let moved = [0.02, -0.02, 0.01, 0.05, 0.05, 0.0, 0.02, -0.02, 0.0, 0.0, 0.0, 0.0];
            for (start, moved) in problem.start.iter_mut().zip(moved) {
                *start += moved;
            }
            let mut guess = outcome.iterate;
            guess.states[0] = problem.start;
            let (outcome, seconds) = timed(&problem, &dynamics, &near, &guess, options.repeats);
            print(&options, name, "moved", &outcome, &seconds);
        }
    }
}

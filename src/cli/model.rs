//! Flags of what makes, judges and uses a learned model.

use std::path::PathBuf;

use clap::{Args, Subcommand, ValueEnum};

use crate::model::file::ModelKind;
use crate::model::onnx::Networks;
use crate::plan::planner::SolverChoice;

/// What `train` does where no flag says otherwise.
const FEATURES: FeatureChoice = FeatureChoice::Body;
const METHOD: MethodChoice = MethodChoice::Adam;
const HIDDEN: u16 = 100;
const PASSES: u32 = 100;
const REGULARIZATION: [f64; 3] = [1e-6, 1e-5, 1e-4];
const WINDOW_MS: [f64; 2] = [22.0, 60.0];
const SEED: u64 = 1;

/// Flags of `train`.
#[derive(Debug, Args)]
pub struct TrainArgs {
    /// Flight logs: .mcap, .tlog, .ulg, .bin, or .csv with --mapping.
    #[arg(required = true)]
    pub logs: Vec<PathBuf>,
    /// Vehicle file, or the name of a shipped one.
    #[arg(long)]
    pub vehicle: PathBuf,
    /// The model file to write.
    #[arg(short, long, value_name = "FILE")]
    pub out: PathBuf,
    /// Folder for report.html and report.json; created if missing.
    #[arg(long, value_name = "DIR")]
    pub report: Option<PathBuf>,
    /// Mapping of the columns of CSV logs.
    #[arg(long, value_name = "FILE")]
    pub mapping: Option<PathBuf>,
    /// Inputs of the networks.
    #[arg(long, value_enum, default_value_t = FEATURES)]
    pub features: FeatureChoice,
    /// Optimiser of the weights.
    #[arg(long, value_enum, default_value_t = METHOD)]
    pub method: MethodChoice,
    /// Hidden units of each network.
    #[arg(long, default_value_t = HIDDEN, value_parser = clap::value_parser!(u16).range(1..=256))]
    pub hidden: u16,
    /// Passes through the training rows, at most.
    #[arg(long, default_value_t = PASSES, value_parser = clap::value_parser!(u32).range(1..))]
    pub passes: u32,
    /// Weights of L2 regularisation to try; the validation rows decide.
    #[arg(long, value_delimiter = ',', default_values_t = REGULARIZATION)]
    pub regularization: Vec<f64>,
    /// Half widths of the window that makes labels, ms. A later one is tried only if the models of
    /// the earlier one do not predict better than holding the state.
    #[arg(long, value_name = "MS", value_delimiter = ',', default_values_t = WINDOW_MS)]
    pub window: Vec<f64>,
    /// Seed of the initial weights.
    #[arg(long, default_value_t = SEED)]
    pub seed: u64,
    /// Threads [default: one for each core]. The model does not depend on it.
    #[arg(long, value_parser = clap::value_parser!(u16).range(1..=1024))]
    pub threads: Option<u16>,
    /// Resumes from the checkpoint that an interrupted training left next to --out.
    #[arg(long)]
    pub resume: bool,
    /// Prints the summary as JSON.
    #[arg(long)]
    pub json: bool,
}

impl TrainArgs {
    /// A training on `logs` of the vehicle file `vehicle` into the model file `out`, as without
    /// another flag.
    pub fn new(logs: Vec<PathBuf>, vehicle: PathBuf, out: PathBuf) -> Self {
        Self {
            logs,
            vehicle,
            out,
            report: None,
            mapping: None,
            features: FEATURES,
            method: METHOD,
            hidden: HIDDEN,
            passes: PASSES,
            regularization: REGULARIZATION.to_vec(),
            window: WINDOW_MS.to_vec(),
            seed: SEED,
            threads: None,
            resume: false,
            json: false,
        }
    }
}

/// Inputs of the networks.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum FeatureChoice {
    /// As in the paper: all in world axes.
    World,
    /// Seen from the vehicle's heading, so that what holds at one heading holds at every other.
    Heading,
    /// Seen from the vehicle: velocity, down and linear acceleration in its axes.
    Body,
}

/// Optimiser of the weights.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum MethodChoice {
    /// Adam over shuffled batches: reaches lower errors in fewer passes.
    Adam,
    /// Resilient backpropagation over all rows at once, as in the paper.
    Rprop,
}

/// Commands on model files.
#[derive(Debug, Subcommand)]
pub enum ModelCommand {
    /// Shows what a model file contains, and how it was trained.
    Info {
        /// Model file.
        #[arg(required_unless_present = "model")]
        file: Option<PathBuf>,
        /// Model file.
        #[arg(long, conflicts_with = "file")]
        model: Option<PathBuf>,
        /// Prints one JSON object.
        #[arg(long)]
        json: bool,
    },
    /// Evaluates a model on flight logs: accelerations and open-loop predictions.
    Eval {
        /// Flight logs: .mcap, .tlog, .ulg, .bin, or .csv with --mapping.
        #[arg(required = true)]
        logs: Vec<PathBuf>,
        /// Model file.
        #[arg(long)]
        model: PathBuf,
        /// Vehicle file of the logs, to check that the model is for it.
        #[arg(long)]
        vehicle: Option<PathBuf>,
        /// Mapping of the columns of CSV logs.
        #[arg(long, value_name = "FILE")]
        mapping: Option<PathBuf>,
        /// Prints one JSON object.
        #[arg(long)]
        json: bool,
    },
    /// Writes open-loop predictions from every sample of a log as CSV.
    ///
    /// Columns run,start,h,x,y,z,vx,vy,vz,qw,qx,qy,qz,wx,wy,wz; world NED, body FRD, SI. A sample
    /// is a row of a CSV log, or of the 100 Hz grid of any other.
    Predict {
        /// Flight log: .mcap, .tlog, .ulg, .bin, or .csv with --mapping.
        log: PathBuf,
        /// Model file.
        #[arg(long)]
        model: PathBuf,
        /// Prediction horizon, s.
        #[arg(long, default_value_t = 0.5)]
        horizon: f64,
        /// Which of the file's models [default: the one that did best in its validation].
        #[arg(long, value_enum)]
        kind: Option<ModelKind>,
        /// Vehicle file of the log, to check that the model is for it.
        #[arg(long)]
        vehicle: Option<PathBuf>,
        /// Mapping of the columns of a CSV log.
        #[arg(long, value_name = "FILE")]
        mapping: Option<PathBuf>,
        /// The CSV to write [default: stdout].
        #[arg(short, long)]
        out: Option<PathBuf>,
    },
    /// Exports the networks for other programs.
    Export {
        /// Model file.
        #[arg(required_unless_present = "model")]
        file: Option<PathBuf>,
        /// Model file.
        #[arg(long, conflicts_with = "file")]
        model: Option<PathBuf>,
        /// The ONNX file to write.
        #[arg(short, long, visible_alias = "onnx", value_name = "FILE")]
        out: PathBuf,
        /// The model whose networks to export; the physics has none.
        #[arg(long, value_enum, default_value_t = Networks::Net)]
        kind: Networks,
    },
}

/// Flags of `plan`.
#[derive(Debug, Args)]
pub struct PlanArgs {
    /// Desired trajectory (TOML or CSV), or the name of a shipped one.
    pub trajectory: PathBuf,
    /// Model file from `train` [default: the vehicle file's own physics].
    #[arg(long, value_name = "FILE")]
    pub model: Option<PathBuf>,
    /// Which of its models [default: the one that predicted best].
    #[arg(long, value_enum, requires = "model")]
    pub kind: Option<ModelKind>,
    /// Vehicle file, or the name of a shipped one [default: the model's vehicle, else
    /// crazyflie].
    #[arg(long)]
    pub vehicle: Option<PathBuf>,
    /// The plan to write.
    #[arg(short, long, value_name = "FILE", default_value = "plan.json")]
    pub out: PathBuf,
    /// Folder for report.html and report.json; created if missing.
    #[arg(long, value_name = "DIR")]
    pub report: Option<PathBuf>,
    /// Tube from `tube fit`, used as the margin to keep-out regions.
    #[arg(long, value_name = "FILE")]
    pub tube: Option<PathBuf>,
    /// Confidence of the tube: the least probability that a whole flight stays within it.
    #[arg(long, default_value_t = 0.95, value_parser = confidence, requires = "tube")]
    pub confidence: f64,
    /// Confidence of the margin to keep-out regions [default: the highest that the tube supports,
    /// that of its worst calibration flight].
    #[arg(long, value_parser = confidence, requires = "tube")]
    pub keep_out_confidence: Option<f64>,
    /// Solver of the subproblems.
    #[arg(long, value_enum)]
    pub solver: Option<SolverChoice>,
    /// Ends the search after this time, s, with the best plan so far [default: 8, or the
    /// configuration's].
    #[arg(long, value_name = "SECONDS")]
    pub time_limit: Option<f64>,
    /// Configuration file.
    #[arg(long)]
    pub config: Option<PathBuf>,
    /// Prints the summary as JSON.
    #[arg(long)]
    pub json: bool,
}

/// A probability strictly between 0 and 1.
fn confidence(text: &str) -> Result<f64, String> {
    let value: f64 = text.parse().map_err(|_| format!("expected a number, found {text:?}"))?;
    let is_one = value > 0.0 && value < 1.0;
    is_one
        .then_some(value)
        .ok_or_else(|| format!("expected a number above 0 and below 1, found {text}"))
}

#[cfg(test)]
mod tests {
    use clap::Parser;

    use super::*;

    #[derive(Parser)]
    struct Train {
        #[command(flatten)]
        args: TrainArgs,
    }

    #[test]
    fn train_args_default_to_the_command_line_defaults() {
        let typed = ["train", "a.mcap", "--vehicle", "v.toml", "--out", "m.safetensors"];
        let typed = Train::try_parse_from(typed).expect("arguments").args;
        let made = TrainArgs::new(vec!["a.mcap".into()], "v.toml".into(), "m.safetensors".into());
        assert_eq!(format!("{typed:?}"), format!("{made:?}"));
    }
}

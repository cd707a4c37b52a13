//! The cases of an exam, and their order.

use anyhow::{Context, anyhow};
use vehicle::VehicleParams;

use crate::cli::ExamArgs;
use crate::command::{Exit, ExitContext};
use crate::exam::draw::Draw;
use crate::exam::order::{Kind, Order, RoundTrip, Settings};
use crate::exam::world::World;

/// Stream of the exam's seed that the kinds and their order are drawn from.
const ORDER: u64 = 0;
/// Default number of cases with something to find.
const CASES: usize = 60;
/// The vehicles of a round trip.
const SHIPPED: [&str; 2] = [
    include_str!("../../../config/vehicles/crazyflie.toml"),
    include_str!("../../../config/vehicles/quad1200.toml"),
];

/// The selection of cases by the flags of `exam`.
#[derive(Clone, Debug, Default)]
pub(in crate::command) struct Questions {
    /// Number of cases with something to find; by default all of a round trip, else [`CASES`].
    pub cases: Option<usize>,
    /// Number of cases with nothing to find.
    pub nulls: usize,
    /// Only cases of these kinds; all kinds if empty.
    pub kinds: Vec<Kind>,
    /// Every effect at every strength on every shipped vehicle with logs in every condition.
    pub round_trip: bool,
}

impl From<&ExamArgs> for Questions {
    fn from(args: &ExamArgs) -> Self {
        let ExamArgs { cases, nulls, kinds, round_trip, .. } = args;
        Self { cases: *cases, nulls: *nulls, kinds: kinds.clone(), round_trip: *round_trip }
    }
}

impl Questions {
    /// The orders of all cases, shuffled so that a case's name reveals nothing.
    ///
    /// # Errors
    /// An invalid built-in vehicle, which cannot occur.
    pub fn orders(&self, seed: u64) -> anyhow::Result<Vec<Order>> {
        let mut draw = Draw::new(seed, ORDER);
        let mut orders = if self.round_trip {
            let vehicles: Vec<VehicleParams> = SHIPPED
                .iter()
                .map(|text| VehicleParams::from_toml_str(text))
                .collect::<Result<_, _>>()
                .context("a built-in vehicle")?;
            RoundTrip::all(&vehicles)
        } else {
            self.drawn().into_iter().map(Order::from).collect()
        };
        draw.shuffle(&mut orders);
        if self.round_trip {
            orders.truncate(self.cases.unwrap_or(usize::MAX));
        }
        Ok(orders)
    }

    fn drawn(&self) -> Vec<Kind> {
        let shares: Vec<(Kind, f64)> = Kind::SHARES
            .into_iter()
            .filter(|(kind, _)| self.kinds.is_empty() || self.kinds.contains(kind))
            .collect();
        let total: f64 = shares.iter().map(|(_, share)| share).sum();
        let count = self.cases.unwrap_or(CASES) as f64;
        let mut kinds = vec![Kind::Null; self.nulls];
        let (mut target, mut before) = (0.0, 0);
        for (kind, share) in shares {
            target += share / total * count;
            let upto = f64::round(target) as usize;
            kinds.extend(std::iter::repeat_n(kind, upto - before));
            before = upto;
        }
        kinds
    }
}

/// The settings that all cases share.
///
/// # Errors
/// `strengths` is not two ratios above 0 in ascending order.
pub(in crate::command) fn settings(
    seconds: f64,
    strengths: &[f64],
    exact: bool,
) -> anyhow::Result<Settings> {
    let ratios = match *strengths {
        [least, most] if least > 0.0 && most >= least => [least, most],
        _ => {
            return Err(anyhow!("strengths: expected two ratios above 0, found {strengths:?}"))
                .or_exit(Exit::Usage);
        }
    };
    let world = if exact { World::Exact } else { World::Builders };
    Ok(Settings { seconds, ratios, world, ..Settings::default() })
}

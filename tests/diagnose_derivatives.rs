//! Derivatives of what is left unexplained, by numbers that change with the flight.

use std::fs;
use std::path::Path;

use downwash::diagnose::hypothesis::Catalogue;
use downwash::diagnose::observed::Observed;
use downwash::diagnose::preparation::PreparedFlight;
use downwash::diagnose::residuals::Evaluator;
use downwash::exam::case::{Case, Kind, Order, Settings};
use downwash::log::import;
use sitl::effects::EffectId;

#[test]
fn a_number_that_changes_as_much_at_any_time_has_its_usual_derivative() {
    let settings = Settings { flights: 1, seconds: 12.0, ..Settings::default() };
    let case = Case::fly(&settings, 5, 0, "quad", &Order::from(Kind::Null)).expect("a case");
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("diagnose-derivatives");
    fs::create_dir_all(&folder).expect("a folder");
    let path = folder.join("flight.tlog");
    fs::write(&path, &case.logs[0]).expect("a file");
    let flight = import::open(&path, None).expect("a log");
    let flights = [PreparedFlight::new(flight, &case.nominal).expect("a flight")];

    let catalogue = Catalogue::new(&case.nominal, true);
    let evaluator = Evaluator::new(&case.nominal).observing(&flights);
    let observed = Observed::new(&flights, &evaluator, &catalogue);
    let values = catalogue.expected();
    let base = observed.residuals(&values).expect("residuals");
    // Of a force, of a moment, and of what turns the reports.
    for (effect, slot) in
        [(EffectId::Mass, 0), (EffectId::YawTorque, 0), (EffectId::AttitudeTrim, 1)]
    {
        let number = catalogue.number_of(effect, slot).expect("a number");
        let usual = observed.column(&values, &base, number).expect("a derivative");
        let weighed = observed.columns_by_weight(&values, number, |_, _| vec![1.0, -2.0]);
        let weighed = weighed.expect("derivatives");
        let size = usual.iter().flatten().fold(0.0, |most: f64, x| most.max(x.abs()));
        assert!(size > 0.0, "{effect}");
        for (column, weight) in weighed.iter().zip([1.0, -2.0]) {
            assert_eq!(column[0].len(), usual[0].len(), "{effect}");
            for (weighed, usual) in column.iter().flatten().zip(usual.iter().flatten()) {
                assert!((weighed - weight * usual).abs() < 1e-6 * size, "{effect}");
            }
        }
    }
}

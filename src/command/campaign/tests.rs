use super::*;
use crate::campaign::judge::Rule;
use crate::planted::{self, Planted};

/// Seed of the flights that a test run draws.
fn seed() -> u64 {
    let given = std::env::var("DOWNWASH_CAMPAIGN_SEED").ok().and_then(|text| text.parse().ok());
    given.unwrap_or(1)
}

/// The first of these flights that breaks a rule.
fn first_failure(seed: u64, numbers: impl IntoIterator<Item = usize>) -> Option<CampaignFlight> {
    let fly = |number| flown(number, &draw::script(seed, number as u64)).expect("a flight");
    numbers.into_iter().map(fly).find(|flight| !flight.violations.is_empty())
}

/// `tests/run` flies 300 of them, `tests/run --all` 10 000.
#[test]
fn drawn_flights_break_no_rule() {
    let seed = seed();
    println!("campaign of seed {seed}");
    if let Some(flight) = first_failure(seed, 0..100) {
        panic!(
            "{:#?}\nagain: downwash campaign --seed {seed} --draw {} > script.json; \
             downwash campaign --script script.json",
            flight.violations, flight.index
        );
    }
}

#[test]
fn same_script_gives_the_same_bytes() {
    for number in [2, 3, 5] {
        let script = draw::script(7, number);
        let text = script_text(&script).expect("a text");
        let again = Script::parse(&text).expect("a script");
        assert_eq!(again, script);
        let toml = toml::to_string(&script).expect("a text");
        assert_eq!(Script::parse(&toml).expect("a script"), script);
        let digests = [&script, &again].map(|it| flown(0, it).expect("a flight").digest);
        assert_eq!(digests[0], digests[1]);
    }
}

/// Flies drawn flights with a planted bug until one breaks a rule; returns its number and the rule.
fn found(bug: Planted, most: usize) -> Option<(usize, Rule)> {
    planted::plant(Some(bug));
    let failure = first_failure(1, 0..most);
    planted::plant(None);
    failure.map(|flight| (flight.index, flight.violations[0].rule))
}

fn is_found(bug: Planted, rules: &[Rule]) {
    let (number, rule) = found(bug, 1000).expect("found within 1000 flights");
    println!("{bug:?}: flight {number}, {rule:?}");
    assert!(rules.contains(&rule), "{bug:?} by {rule:?}");
}

#[test]
fn campaign_detects_a_removed_guard() {
    is_found(Planted::GuardRemoved, &[Rule::AgainstThePilot, Rule::AfterLanding, Rule::OldMode]);
    is_found(Planted::LimitsRemoved, &[Rule::Limits]);
}

#[test]
fn campaign_detects_a_resent_setpoint() {
    is_found(Planted::SentAgain, &[Rule::Fresh]);
}

#[test]
fn campaign_detects_a_doubled_deadline() {
    is_found(Planted::DeadlineDoubled, &[Rule::AfterLanding]);
    is_found(Planted::StallDoubled, &[Rule::Stalled]);
}

#[test]
fn campaign_detects_an_accepted_older_heartbeat() {
    is_found(Planted::OlderHeartbeat, &[Rule::OldMode, Rule::AgainstThePilot]);
}

/// Scripts with which a campaign found faults, since fixed; each file is named after its fault.
#[test]
fn failures_found_by_campaigns_stay_fixed() {
    let folder = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/campaign_found");
    let files =
        std::fs::read_dir(&folder).expect("the folder").map(|file| file.expect("it").path());
    let mut count = 0;
    for file in files {
        let text = std::fs::read_to_string(&file).expect("a file");
        let script = Script::parse(&text).expect("a script");
        let flight = flown(0, &script).expect("a flight");
        assert_eq!(flight.violations, [], "{}", file.display());
        count += 1;
    }
    assert!(count > 0, "no script in {}", folder.display());
}

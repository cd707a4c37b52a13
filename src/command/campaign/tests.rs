use super::*;
use crate::campaign::judge::Rule;
use crate::planted::{self, Planted};

/// Seed of the flights that a test run draws.
fn seed() -> u64 {
    let given = std::env::var("DOWNWASH_CAMPAIGN_SEED").ok().and_then(|text| text.parse().ok());
    given.unwrap_or(1)
}

/// The first flight of these that breaks a rule.
fn first_failure(seed: u64, numbers: impl IntoIterator<Item = usize>) -> Option<CampaignFlight> {
    let fly = |number| flown(number, &draw::script(seed, number as u64)).expect("a flight");
    numbers.into_iter().map(fly).find(|flight| !flight.violations.is_empty())
}

/// `tests/run` flies more of them.
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
fn the_same_script_gives_the_same_bytes() {
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

/// Flies drawn flights with a bug until one is found; how many it took, and the rule.
fn found(bug: Planted, most: usize) -> Option<(usize, Rule)> {
    planted::plant(Some(bug));
    let failure = first_failure(1, 0..most);
    planted::plant(None);
    failure.map(|flight| (flight.index, flight.violations[0].rule))
}

fn is_found(bug: Planted, rules: &[Rule]) {
    let (number, rule) = found(bug, 1000).expect("it is found within 1000 flights");
    println!("{bug:?}: flight {number}, {rule:?}");
    assert!(rules.contains(&rule), "{bug:?} by {rule:?}");
}

#[test]
fn a_guard_that_is_removed_is_found() {
    is_found(Planted::GuardRemoved, &[Rule::AgainstThePilot, Rule::AfterLanding, Rule::OldMode]);
    is_found(Planted::LimitsRemoved, &[Rule::Limits]);
}

#[test]
fn a_setpoint_that_is_sent_again_is_found() {
    is_found(Planted::SentAgain, &[Rule::Fresh]);
}

#[test]
fn a_deadline_that_is_doubled_is_found() {
    is_found(Planted::DeadlineDoubled, &[Rule::AfterLanding]);
    is_found(Planted::StallDoubled, &[Rule::Stalled]);
}

#[test]
fn an_older_heartbeat_that_is_believed_is_found() {
    is_found(Planted::OlderHeartbeat, &[Rule::OldMode, Rule::AgainstThePilot]);
}

/// Scripts that a campaign found faults of the program with, since mended.
#[test]
fn what_campaigns_found_stays_mended() {
    let hover = "family = \"hover\"\naltitude_m = 1.0\nduration_s = 3.0\n";
    let cases = [
        // An estimate that froze under new stamps was flown by: metres high within a second.
        ("crazyflie", "bundled", r#"[{"at_s":4.518,"for_s":1.21,"fault":{"kind":"freeze"}}]"#),
        ("quad1200", "bundled", r#"[{"at_s":3.902,"for_s":2.7,"fault":{"kind":"freeze"}}]"#),
        // A copy of an old HEARTBEAT gave back control that the vehicle had ended by landing.
        (
            "crazyflie",
            "px4",
            r#"[{"at_s":17.3,"for_s":0.5,"fault":{"kind":"replay","age_s":4.6,"rate_hz":90.0}}]"#,
        ),
    ];
    for (vehicle, autopilot, faults) in cases {
        let script = serde_json::json!({
            "schema_version": 1, "seed": 7, "vehicle": vehicle, "autopilot": autopilot,
            "law": "lqr", "policy": "command", "clock_rate": 1.0, "trajectory": hover,
            "faults": serde_json::from_str::<serde_json::Value>(faults).expect("faults"),
        });
        let script = Script::parse(&script.to_string()).expect("a script");
        let flight = flown(0, &script).expect("a flight");
        assert_eq!(flight.violations, [], "{faults}");
    }
}

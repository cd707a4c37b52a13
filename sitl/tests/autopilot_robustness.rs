//! The output depends only on the seed and the input bytes, and no input makes the vehicle panic.

use crate::bench;
use crate::bench::{Bench, setpoint};
use proptest::prelude::*;
use sitl::autopilot::{LinkKind, Mode, Peer};
use wire::Encoder;
use wire::dialect::*;

fn flight(seed: u64) -> Vec<u8> {
    let mut bench = Bench::with_seed(seed);
    bench.fly();
    bench.stream(setpoint(0.1, 0.2, 0.5, 0x00));
    bench.run(0.1);
    bench.set_mode(Mode::Offboard);
    bench.run(1.0);
    bench.stop_stream();
    bench.run(3.0);
    bench.bytes_out
}

#[test]
fn same_seed_gives_the_same_bytes() {
    let first = flight(7);
    assert!(first.len() > 100_000);
    assert!(first == flight(7), "bytes differ");
    assert!(first != flight(8), "the seed has no effect");
}

#[test]
fn bytes_do_not_depend_on_time_steps() {
    let run = |step_us: usize| {
        let mut bench = Bench::new();
        let mut bytes = Vec::new();
        for time_us in (0..=2_000_000).step_by(step_us) {
            bench.vehicle.advance_to(time_us as u64);
            bench.vehicle.take_output(|_, frame| bytes.extend_from_slice(frame));
        }
        bytes
    };
    assert!(run(1_000) == run(250) && run(1_000) == run(20_000));
}

#[test]
fn frame_split_across_reads_is_decoded() {
    let mut bench = Bench::new();
    bench.vehicle.connect(Peer(5), LinkKind::Stream);
    let mut bytes = Vec::new();
    let arm = bench::command_long(MavCmd::MAV_CMD_COMPONENT_ARM_DISARM, &[1.0]);
    Encoder::new(255, 1).encode(&arm, &mut bytes);
    for byte in bytes {
        bench.vehicle.receive(Peer(5), &[byte]);
    }
    assert!(bench.armed());
}

#[test]
fn vehicle_answers_after_a_flood_of_peers() {
    let mut bench = Bench::new();
    for peer in 0..10_000 {
        bench.vehicle.receive(Peer(peer), b"hello");
    }
    bench.run(0.1);
    assert_eq!(bench.set_mode(Mode::Position), MavResult::MAV_RESULT_ACCEPTED);
}

fn any_message() -> impl Strategy<Value = MavMessage> {
    let id = prop::sample::select(vec![0_u32, 11, 20, 21, 23, 43, 44, 45, 69, 75, 76, 82, 111, 4]);
    (id, prop::collection::vec(any::<u8>(), 0..60)).prop_filter_map("parses", |(id, payload)| {
        use mavlink::{MavlinkVersion, Message};
        MavMessage::parse(MavlinkVersion::V2, id, &payload).ok()
    })
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn garbage_never_panics_the_vehicle(chunks in prop::collection::vec(prop::collection::vec(any::<u8>(), 0..400), 1..20)) {
        let mut bench = Bench::new();
        bench.vehicle.connect(Peer(4), LinkKind::Stream);
        for chunk in chunks {
            bench.vehicle.receive(bench::GROUND, &chunk);
            bench.vehicle.receive(Peer(4), &chunk);
            bench.run(0.01);
        }
        prop_assert_eq!(bench.set_mode(Mode::Position), MavResult::MAV_RESULT_ACCEPTED);
    }

    #[test]
    fn no_message_panics_or_corrupts_the_state(messages in prop::collection::vec(any_message(), 1..60)) {
        let mut bench = Bench::new();
        bench.fly();
        let mut encoder = Encoder::new(255, 190);
        for mut message in messages {
            use mavlink::Message;
            if let Some(system) = message.target_system_id_mut() { *system = 1 }
            if let Some(component) = message.target_component_id_mut() { *component = 0 }
            let mut bytes = Vec::new();
            encoder.encode(&message, &mut bytes);
            bench.vehicle.receive(bench::GROUND, &bytes);
            bench.run(0.02);
        }
        prop_assert!(bench.vehicle.plant().state().is_finite());
    }
}

//! One simulated second of the whole vehicle, in flight, with a peer that asked for every stream
//! of a flight log and streams setpoints at 100 Hz.

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use sitl::autopilot::{LinkKind, Peer, Vehicle};
use sitl::config::SitlConfig;
use vehicle::VehicleParams;
use vehicle::effects::EffectSet;
use wire::Encoder;
use wire::dialect::*;

const VEHICLE: &str = r#"
name = "bench"
mass = 0.5
inertia = [0.003, 0.003, 0.005]
motor_time_constant_s = 0.03
command_delay_s = 0.005
attitude_pd = { kp = [0.6, 0.6, 0.3], kd = [0.075, 0.075, 0.06], rate_hz = 250.0 }
hover_thrust = 0.4905
gravity = 9.81
air_density = 1.2
rotor_radius_m = 0.06
battery = { cells = 3, full_V = 12.6, nominal_V = 11.1 }
rotors = [
  { position_m = [0.1, 0.1, 0.0], spin = 1, thrust_max_N = 2.5, drag_torque_per_thrust_m = 0.015 },
  { position_m = [-0.1, 0.1, 0.0], spin = -1, thrust_max_N = 2.5, drag_torque_per_thrust_m = 0.015 },
  { position_m = [-0.1, -0.1, 0.0], spin = 1, thrust_max_N = 2.5, drag_torque_per_thrust_m = 0.015 },
  { position_m = [0.1, -0.1, 0.0], spin = -1, thrust_max_N = 2.5, drag_torque_per_thrust_m = 0.015 },
]
"#;

fn one_second(criterion: &mut Criterion) {
    let params = VehicleParams::from_toml_str(VEHICLE).expect("a vehicle file");
    let config = SitlConfig::from_toml_str("[start]\nposition_m = [0.0, 0.0, -10.0]")
        .expect("a configuration");
    let mut vehicle = Vehicle::new(params, EffectSet::default(), config, 1).expect("a vehicle");
    let (peer, mut encoder, mut bytes) = (Peer(0), Encoder::new(255, 190), Vec::new());
    vehicle.connect(peer, LinkKind::Datagrams);
    for (id, rate) in [(31, 250.0), (105, 250.0), (32, 100.0), (375, 100.0), (331, 100.0)] {
        let request = MavMessage::COMMAND_LONG(COMMAND_LONG_DATA {
            param1: id as f32,
            param2: 1e6 / rate,
            command: MavCmd::MAV_CMD_SET_MESSAGE_INTERVAL,
            target_system: 1,
            target_component: 1,
            ..Default::default()
        });
        bytes.clear();
        encoder.encode(&request, &mut bytes);
        vehicle.receive(peer, &bytes);
    }
    let setpoint = MavMessage::SET_ATTITUDE_TARGET(SET_ATTITUDE_TARGET_DATA {
        q: [1.0, 0.0, 0.0, 0.0],
        thrust: 0.4905,
        target_system: 1,
        target_component: 1,
        type_mask: AttitudeTargetTypemask::empty(),
        ..Default::default()
    });

    let mut group = criterion.benchmark_group("vehicle");
    group.throughput(Throughput::Elements(1));
    group.bench_function("simulated second", |bencher| {
        bencher.iter(|| {
            let mut sent = 0;
            for _ in 0..100 {
                bytes.clear();
                encoder.encode(&setpoint, &mut bytes);
                vehicle.receive(peer, &bytes);
                let end = vehicle.now_us() + 10_000;
                while vehicle.now_us() < end {
                    vehicle.advance_to(vehicle.next_event_us().min(end));
                    vehicle.take_output(|_, frame| sent += frame.len());
                }
            }
            sent
        });
    });
    group.finish();
}

criterion_group!(benches, one_second);
criterion_main!(benches);

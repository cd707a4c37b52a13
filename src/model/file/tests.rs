//! A model file survives being written and read; anything else is rejected.

use proptest::prelude::*;
use serde_json::{Value, json};

use super::super::tests::{networks, physics_parameters, vehicle};
use super::*;

fn name() -> &'static Path {
    Path::new("a.safetensors")
}

fn model(features: Features) -> ModelFile {
    let values: Vec<f32> = (0..401).map(|i| (i as f32 * 0.61).sin()).collect();
    ModelFile {
        vehicle: vehicle(),
        actuation: Actuation {
            delay_s: 0.0213,
            lag_s: 0.0501,
            voltage_exponent: 1.4,
            balance_s: Some(0.7),
        },
        acceleration: AccelerationSource::SpecificForce,
        deviation: [1.1, 1.2, 1.3, 14.0, 15.0, 1.6],
        net: networks(features, 7, &values),
        physics: physics_parameters(),
        residual: networks(Features::World, 5, &values[3..]),
        preferred: ModelKind::Hybrid,
        training: json!({ "schema": "test", "loss": [0.1, 1e-300, 3] }),
    }
}

fn bytes(features: Features) -> Vec<u8> {
    model(features).to_bytes().expect("bytes")
}

fn refusal(bytes: &[u8]) -> ModelFileError {
    ModelFile::from_bytes(bytes, name()).expect_err("refused")
}

fn is_damaged(bytes: &[u8]) -> bool {
    matches!(refusal(bytes), ModelFileError::Damaged { .. })
}

/// Offset of the first tensor.
fn body(bytes: &[u8]) -> usize {
    8 + u64::from_le_bytes(*bytes.first_chunk().expect("a length")) as usize
}

/// The file with changed metadata and everything else as before, hash included.
fn with_metadata(bytes: &[u8], change: impl FnOnce(&mut Value)) -> Vec<u8> {
    let start = body(bytes);
    let mut header: Value = serde_json::from_slice(&bytes[8..start]).expect("JSON");
    let text = header["__metadata__"][KEY].as_str().expect("a text").to_owned();
    let mut content: Value = serde_json::from_str(&text).expect("JSON");
    change(&mut content);
    header["__metadata__"][KEY] = content.to_string().into();
    let mut header = header.to_string().into_bytes();
    header.resize(header.len().next_multiple_of(8), b' ');
    let length = (header.len() as u64).to_le_bytes();
    [&length[..], &header, &bytes[start..]].concat()
}

#[test]
fn model_round_trips_through_its_file() {
    for features in [Features::World, Features::Heading] {
        let back = ModelFile::from_bytes(&bytes(features), name()).expect("a model");
        assert_eq!(back, model(features));
        assert_eq!(back.to_bytes().expect("bytes"), bytes(features));
    }
}

#[test]
fn vehicle_file_in_place_of_a_model_is_named_as_text() {
    let error = refusal(b"name = \"quad\"\nmass = 0.030\n");
    assert!(matches!(error, ModelFileError::Text { .. }), "{error}");
    assert!(error.to_string().contains("--vehicle"), "{error}");
}

#[test]
fn same_model_gives_the_same_bytes() {
    // Each run creates a new hash map, whose order differs.
    let first = bytes(Features::World);
    assert!((0..20).all(|_| bytes(Features::World) == first));
}

#[test]
fn flipped_byte_in_the_weights_is_detected() {
    let sound = bytes(Features::World);
    for at in body(&sound)..sound.len() {
        let mut spoiled = sound.clone();
        spoiled[at] ^= 0x10;
        assert!(is_damaged(&spoiled), "byte {at}");
    }
}

#[test]
fn changed_metadata_is_detected() {
    let sound = bytes(Features::World);
    assert!(ModelFile::from_bytes(&with_metadata(&sound, |_| ()), name()).is_ok());
    for (pointer, value) in [
        ("/actuation/delay_s", json!(0.03)),
        ("/vehicle/mass", json!(0.031)),
        ("/physics/angular_damping_nms/1", json!(4e-6)),
        ("/deviation/0", json!(1.0)),
        ("/preferred", json!("net")),
        ("/features", json!("heading")),
        ("/training/loss/0", json!(0.2)),
        ("/sha256", json!("")),
    ] {
        let spoiled = with_metadata(&sound, |content| {
            *content.pointer_mut(pointer).expect("a value") = value;
        });
        assert!(is_damaged(&spoiled), "{pointer}");
    }
}

#[test]
fn truncated_file_is_refused() {
    let sound = bytes(Features::Heading);
    for length in 0..sound.len() {
        assert!(is_damaged(&sound[..length]), "{length} bytes");
    }
    let longer = [&sound[..], b"more"].concat();
    assert!(is_damaged(&longer));
}

#[test]
fn foreign_format_or_version_is_named_in_the_error() {
    let sound = bytes(Features::World);
    let newer = with_metadata(&sound, |content| {
        *content = json!({ "format": FORMAT, "version": 2, "surprise": true });
    });
    let error = refusal(&newer);
    assert!(matches!(error, ModelFileError::Version { found: 2, .. }), "{error}");
    assert!(error.to_string().contains("a.safetensors"), "{error}");
    let other = with_metadata(&sound, |content| content["format"] = json!("someone's model"));
    assert!(refusal(&other).to_string().contains("someone's model"));
    let lacking = with_metadata(&sound, |content| {
        content.as_object_mut().expect("an object").remove("actuation");
    });
    assert!(refusal(&lacking).to_string().contains("actuation"));
    let plain = safetensors::serialize(Vec::<(String, TensorView<'_>)>::new(), None);
    assert!(is_damaged(&plain.expect("an empty file")));
}

#[test]
fn non_finite_weights_are_refused() {
    for spoil in [
        (|file| file.net.linear.mlp.hidden_weights[3] = f32::NAN) as fn(&mut ModelFile),
        |file| file.residual.angular.mlp.output_biases[1] = f32::INFINITY,
        |file| file.net.angular.inputs.mean[2] = f64::NAN,
        |file| file.net.linear.outputs.deviation[0] = 0.0,
        |file| file.net.linear.inputs.deviation[0] = -1.0,
    ] {
        let mut file = model(Features::World);
        spoil(&mut file);
        assert!(is_damaged(&file.to_bytes().expect("bytes")));
    }
}

#[test]
fn networks_of_the_wrong_shape_are_refused() {
    let mut file = model(Features::World);
    file.net.linear = file.residual.angular.clone();
    assert!(is_damaged(&file.to_bytes().expect("bytes")));
    let mut file = model(Features::World);
    file.net.features = Features::Heading;
    assert!(is_damaged(&file.to_bytes().expect("bytes")));
}

#[test]
fn model_is_refused_for_another_vehicle() {
    let file = model(Features::World);
    file.check_vehicle(&vehicle(), name()).expect("its own");
    let mut renamed = vehicle();
    renamed.name = "other".to_owned();
    file.check_vehicle(&renamed, name()).expect("the name does not matter");
    let mut silent = vehicle();
    silent.attitude_pd = None;
    file.check_vehicle(&silent, name()).expect("a missing value is no contradiction");
    for (change, words) in [
        ((|v| v.mass *= 1.1) as fn(&mut VehicleParams), "mass"),
        (|v| v.inertia[1] *= 1.2, "inertia"),
        (|v| v.rotors[2].thrust_max_n *= 0.9, "thrust"),
        (|v| v.attitude_pd.as_mut().expect("a loop").kp[0] *= 2.0, "attitude_pd"),
    ] {
        let mut other = vehicle();
        change(&mut other);
        let error = file.check_vehicle(&other, name()).expect_err("another").to_string();
        assert!(error.contains(words) && error.contains("a.safetensors"), "{error}");
    }
}

#[test]
fn every_model_kind_can_be_evaluated() {
    let file = model(Features::Heading);
    for kind in ModelKind::ALL {
        let model = file.model(kind).expect("a model");
        let result = model.accelerations(&crate::model::Point::default());
        assert!(result.iter().all(|a| a.is_finite()), "{kind:?}");
    }
}

proptest! {
    #[test]
    fn arbitrary_bytes_never_panic_the_reader(noise in prop::collection::vec(any::<u8>(), 0..400)) {
        prop_assert!(ModelFile::from_bytes(&noise, name()).is_err());
        // With a plausible length prefix.
        let length = (noise.len() as u64 / 2).to_le_bytes();
        prop_assert!(ModelFile::from_bytes(&[&length[..], &noise].concat(), name()).is_err());
    }

    #[test]
    fn damaged_file_is_refused_or_gives_the_same_model(
        places in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..6),
    ) {
        let mut spoiled = bytes(Features::World);
        for (place, byte) in places {
            let at = place.index(spoiled.len());
            spoiled[at] = byte;
        }
        // A file that still parses, for example with one blank replaced by another, is the same
        // model.
        if let Ok(read) = ModelFile::from_bytes(&spoiled, name()) {
            prop_assert_eq!(read, model(Features::World));
        }
    }
}

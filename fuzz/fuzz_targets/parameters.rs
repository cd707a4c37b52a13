#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| downwash_fuzz::parameters(data));

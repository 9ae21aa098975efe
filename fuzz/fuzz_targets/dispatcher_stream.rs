#![no_main]
use mcdpr_tests::fuzz::wire;

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    wire::dispatcher_stream(bytes);
});

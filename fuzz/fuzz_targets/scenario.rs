#![no_main]
use mcdpr_tests::fuzz::files;

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    if let Ok(text) = std::str::from_utf8(bytes) {
        files::scenario(text);
    }
});

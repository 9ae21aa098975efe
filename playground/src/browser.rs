//! The functions that a browser calls, and those that it supplies.
//!
//! Texts go in byte by byte and come out as a place in memory: nothing needs generated glue.
#![allow(unsafe_code)] // The names of these functions are the interface to the page.

use crate::Host;
use std::cell::RefCell;
use std::collections::VecDeque;

#[link(wasm_import_module = "page")]
unsafe extern "C" {
    /// Suspends until this time has passed, ms.
    safe fn pause(ms: f64);
    /// The page's time, ms.
    safe fn now_ms() -> f64;
    /// Passes a text (UTF-8) to the page, which reads it before it returns.
    safe fn deliver(text: *const u8, length: usize);
    /// Passes the reason of a crash.
    safe fn failed(text: *const u8, length: usize);
}

#[derive(Default)]
struct Inbox {
    next: Vec<u8>,
    messages: VecDeque<String>,
    file: Option<Vec<u8>>,
}

thread_local! {
    static INBOX: RefCell<Inbox> = RefCell::default();
}

/// One more byte of the page's next message.
#[unsafe(no_mangle)]
pub extern "C" fn put(byte: u8) {
    INBOX.with_borrow_mut(|inbox| inbox.next.push(byte));
}

/// The page's message is complete.
#[unsafe(no_mangle)]
pub extern "C" fn sent() {
    INBOX.with_borrow_mut(|inbox| {
        let bytes = std::mem::take(&mut inbox.next);
        let text = String::from_utf8_lossy(&bytes).into_owned();
        inbox.messages.push_back(text);
    });
}

/// The page's bytes are a file, which an order is about to name.
#[unsafe(no_mangle)]
pub(crate) extern "C" fn sent_file() {
    INBOX.with_borrow_mut(|inbox| inbox.file = Some(std::mem::take(&mut inbox.next)));
}

/// Simulates for the page, and never returns: the page calls it so that it may suspend.
#[unsafe(no_mangle)]
pub extern "C" fn run() {
    std::panic::set_hook(Box::new(|about| {
        let text = about.to_string();
        failed(text.as_ptr(), text.len());
    }));
    crate::stage::run(&Browser, || now_ms() * 1e-3);
}

struct Browser;

impl Host for Browser {
    fn pause(&self, ms: f64) {
        pause(ms);
    }

    fn now_ms(&self) -> f64 {
        now_ms()
    }

    fn take(&self) -> Option<String> {
        INBOX.with_borrow_mut(|inbox| inbox.messages.pop_front())
    }

    fn file(&self) -> Option<Vec<u8>> {
        INBOX.with_borrow_mut(|inbox| inbox.file.take())
    }

    fn deliver(&self, text: &str) {
        deliver(text.as_ptr(), text.len());
    }
}

//! Calls of librealsense2's C interface: handles, layouts, errors.

use crate::source::SourceError;
use libloading::Library;
use std::ffi::{CStr, OsStr, c_char, c_float, c_int, c_void};
use std::fmt::Display;

/// Opaque handle of the library.
pub(super) type Handle = *mut c_void;

/// `rs2_intrinsics`.
#[repr(C)]
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Intrinsics {
    pub width: c_int,
    pub height: c_int,
    pub ppx: c_float,
    pub ppy: c_float,
    pub fx: c_float,
    pub fy: c_float,
    pub model: c_int,
    pub coefficients: [c_float; 5],
}

/// `rs2_extrinsics`: rotation by columns, translation in m.
#[repr(C)]
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Extrinsics {
    pub rotation: [c_float; 9],
    pub translation: [c_float; 3],
}

/// Calls a function whose last argument receives its error.
macro_rules! call {
    ($api:expr, $name:ident($($arg:expr => $type:ty),*) -> $back:ty) => {{
        let mut error: Handle = ptr::null_mut();
        // SAFETY: name and types are the C interface's; the handles came from the same library and
        // live; pointers are to places of this function.
        let (back, error) = unsafe {
            let function = $api.library.get::<unsafe extern "C" fn($($type,)* *mut Handle) -> $back>(
                concat!(stringify!($name), "\0").as_bytes(),
            );
            let function = function.map_err(|error| device(&error))?;
            (function($($arg,)* &raw mut error), error)
        };
        $api.passed(stringify!($name), error).map(|()| back)
    }};
}

/// The library.
pub(super) struct Api {
    pub library: Library,
}

impl Api {
    /// Opens the library by name or path.
    pub fn open(library: &OsStr) -> Result<Self, SourceError> {
        // SAFETY: code that runs on loading is the library's: the user chose it.
        let opened = unsafe { Library::new(library) };
        let library = opened.map_err(|error| {
            device(&format!(
                "{} cannot be opened ({error}): install librealsense2 (version 2)",
                library.display()
            ))
        })?;
        Ok(Self { library })
    }

    /// `Err` with the library's message, if it returned an error.
    pub fn passed(&self, what: &str, error: Handle) -> Result<(), SourceError> {
        if error.is_null() {
            return Ok(());
        }
        // SAFETY: an error of this library, whose message is read before it is released.
        let words = unsafe {
            let message = self
                .library
                .get::<unsafe extern "C" fn(Handle) -> *const c_char>(b"rs2_get_error_message\0");
            let free = self
                .library
                .get::<unsafe extern "C" fn(Handle)>(b"rs2_free_error\0");
            let words = message.map(|message| {
                CStr::from_ptr(message(error))
                    .to_string_lossy()
                    .into_owned()
            });
            if let Ok(free) = free {
                free(error);
            }
            words.unwrap_or_default()
        };
        Err(device(&format!("{what}: {words}")))
    }

    /// Releases a handle, by a function without an error.
    pub fn release(&self, name: &[u8], handle: Handle) {
        if handle.is_null() {
            return;
        }
        // SAFETY: the handle is this library's, of the kind that the function takes, and is not
        // used after this.
        unsafe {
            if let Ok(function) = self.library.get::<unsafe extern "C" fn(Handle)>(name) {
                function(handle);
            }
        }
    }
}

pub(super) fn device(reason: &dyn Display) -> SourceError {
    SourceError::Device {
        name: "RealSense".to_owned(),
        reason: reason.to_string(),
    }
}

pub(super) use call;

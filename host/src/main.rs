//! The `mcdpr` program; everything it does is in the library.

fn main() -> std::process::ExitCode {
    mcdpr::cli::main()
}

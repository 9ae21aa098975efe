//! A busy host: a motion is streamed in real time to `mcdpr sim --pty`, a separate process, while
//! threads keep every core busy, once and twice over. Reports the least motion that was in the
//! board's buffer; an empty buffer would have stopped the robot (K6), and fails the benchmark.

#[cfg(unix)]
mod unix {
    use mcdpr::control::Handle;
    use mcdpr::experiment::Experiment;
    use mcdpr::link::SerialLink;
    use mcdpr::motion::{Model, Plan, Task};
    use mcdpr::robot::Robot;
    use mcdpr::run::{Homing, LengthFiles, Recorder, Session, new_session};
    use std::io::{BufRead, BufReader};
    use std::process::{Child, Command, Stdio};
    use std::sync::Arc;
    use std::sync::atomic::{AtomicBool, Ordering};
    use std::time::Instant;

    /// The simulated robot; ended with this value.
    struct Simulator {
        child: Child,
        port: String,
    }

    impl Simulator {
        fn start() -> Self {
            let mut child = Command::new(env!("CARGO_BIN_EXE_mcdpr"))
                .args(["sim", "--pty", "--ideal", "--robot", "lab-fast"])
                .stdin(Stdio::null())
                .stdout(Stdio::piped())
                .stderr(Stdio::null())
                .spawn()
                .expect("the program starts");
            let mut port = String::new();
            let out = child.stdout.take().expect("it is piped");
            BufReader::new(out)
                .read_line(&mut port)
                .expect("it prints its port");
            let port = port.trim().to_owned();
            Self { child, port }
        }
    }

    impl Drop for Simulator {
        fn drop(&mut self) {
            let _ = self.child.kill();
            let _ = self.child.wait();
        }
    }

    /// Streams the circle with this many competing threads; returns the least motion buffered, s.
    fn stream(model: &Model, plan: &Plan, threads: usize) -> Result<f64, String> {
        let simulator = Simulator::start();
        let over = Arc::new(AtomicBool::new(false));
        let spin = |over: Arc<AtomicBool>| {
            move || {
                while !over.load(Ordering::Relaxed) {
                    std::hint::spin_loop();
                }
            }
        };
        for _ in 0..threads {
            std::thread::spawn(spin(over.clone()));
        }
        let done = follow(model, plan, &simulator.port);
        over.store(true, Ordering::Relaxed);
        done
    }

    fn follow(model: &Model, plan: &Plan, port: &str) -> Result<f64, String> {
        let link = SerialLink::open(port).map_err(|error| error.to_string())?;
        let home = Homing::Place(model.robot().tool.home_in_world_m);
        let handle = Handle::new();
        let mut recorder = Recorder::default();
        let run = || {
            let mut session =
                Session::open(model, link, new_session(), &handle, home, &LengthFiles)?;
            session.arm()?;
            session.follow(plan, &mut recorder, |_| {})?;
            session.disarm()
        };
        run().map_err(|error: mcdpr::run::RunError| error.to_string())?;
        Ok(recorder.least_buffered_s.unwrap_or(f64::NAN))
    }

    pub fn run() {
        let robot = Robot::built_in("lab-fast").expect("a built-in robot");
        let model = Model::new(&robot).expect("three cables are held by length");
        let task = Task::built_in("paper:table7", -0.18).expect("a built-in task");
        let began = Instant::now();
        let plan = Experiment::new(&model, task)
            .plan()
            .expect("it is feasible");
        println!(
            "planning {:.1} s of motion took {:.3} s",
            plan.timed.duration_s(),
            began.elapsed().as_secs_f64()
        );
        let cores = std::thread::available_parallelism().map_or(2, usize::from);
        for threads in [0, cores, 2 * cores] {
            match stream(&model, &plan, threads) {
                Ok(least_s) => println!(
                    "{threads} busy threads on {cores} cores: {:.0} ms in the buffer at the least",
                    least_s * 1e3
                ),
                Err(error) => {
                    eprintln!("{threads} busy threads on {cores} cores: {error}");
                    std::process::exit(1);
                }
            }
        }
    }
}

fn main() {
    #[cfg(unix)]
    unix::run();
    #[cfg(not(unix))]
    println!("this system has no pseudo-terminals");
}

//! The live page.

/// The complete page: no other file and no network is needed.
#[must_use]
pub fn page() -> String {
    page_with("")
}

/// The page with a script before all others.
#[must_use]
pub fn page_with(script: &str) -> String {
    include_str!("page/page.html")
        .replace("/*STYLE*/", include_str!("page/page.css"))
        .replace("/*SCENE*/", include_str!("page/scene.js"))
        .replace("/*SCRIPT*/", include_str!("page/page.js"))
        .replace("/*WORK*/", include_str!("page/work.js"))
        .replace("/*RUNS*/", include_str!("page/runs.js"))
        .replace("/*ROBOT*/", include_str!("page/robot.js"))
        .replace("/*SIM*/", include_str!("page/sim.js"))
        .replace("/*HOST*/", script)
}

//! The live page.

/// The page without its parts: `/*NAME*/` stands where the part NAME belongs.
const FRAME: &str = include_str!("page/page.html");
/// Its parts. `cargo xtask playground` puts the same files together.
const PARTS: [(&str, &str); 15] = [
    ("uPlot.min.css", include_str!("page/uPlot.min.css")),
    ("uPlot.iife.min.js", include_str!("page/uPlot.iife.min.js")),
    ("charts.js", include_str!("page/charts.js")),
    ("livecharts.js", include_str!("page/livecharts.js")),
    ("runcharts.js", include_str!("page/runcharts.js")),
    ("page.css", include_str!("page/page.css")),
    ("setup.css", include_str!("page/setup.css")),
    ("setup.js", include_str!("page/setup.js")),
    ("pick.js", include_str!("page/pick.js")),
    ("scene.js", include_str!("page/scene.js")),
    ("page.js", include_str!("page/page.js")),
    ("work.js", include_str!("page/work.js")),
    ("runs.js", include_str!("page/runs.js")),
    ("robot.js", include_str!("page/robot.js")),
    ("sim.js", include_str!("page/sim.js")),
];

/// The complete page: no other file and no network is needed.
#[must_use]
pub fn page() -> String {
    PARTS.iter().fold(FRAME.to_owned(), |page, (name, text)| {
        page.replace(&format!("/*{name}*/"), text)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_part_is_in_its_place() {
        let page = page();
        for (name, text) in PARTS {
            assert!(FRAME.contains(&format!("/*{name}*/")), "{name}");
            assert!(!text.is_empty() && page.contains(text), "{name}");
        }
    }
}

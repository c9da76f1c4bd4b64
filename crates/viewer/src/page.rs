//! The page itself: the stage with our scripts beside it.

use crate::house::House;
use pwrfgs_report::canvas::text::xml;
use pwrfgs_report::live::STAGE;

/// Style of the page around the stage.
pub(crate) const STYLE: &str = include_str!("view.css");

pub(crate) fn html(house: &House) -> String {
    let names: Vec<String> = house.sides.iter().map(|side| xml(&side.name)).collect();
    format!(
        "<!DOCTYPE html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n<meta name=\"viewport\" \
         content=\"width=device-width, initial-scale=1\">\n<meta name=\"color-scheme\" content=\"light dark\">\n\
         <title>{} · pwrfgs view</title>\n<link rel=\"icon\" href=\"data:,\">\n<link rel=\"stylesheet\" href=\"view.css\">\n<link rel=\"stylesheet\" \
         href=\"stage.css\">\n<script type=\"module\" src=\"stage.js\"></script>\n</head>\n<body>\n<main \
         data-source=\"server\">\n{STAGE}\n</main>\n</body>\n</html>\n",
        names.join(" | ")
    )
}

"""Films, the viewer in the browser, and the page of a study."""

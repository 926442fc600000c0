// A frame grows with the explorer in it. From a file, where a page may not look into its frames, it keeps its height.
for (const frame of document.querySelectorAll("iframe")) {
  const follow = () => {
    const body = frame.contentDocument?.body;
    if (body?.childElementCount) {
      new ResizeObserver(() => { frame.style.height = `${body.offsetHeight + 40}px`; }).observe(body);
    }
  };
  frame.addEventListener("load", follow);
  follow();
}

// Who has no mouse scrolls what is wider than the page once the keyboard can reach it.
const reachable = new ResizeObserver((entries) => {
  for (const { target } of entries) {
    if (target.scrollWidth > target.clientWidth) target.tabIndex = 0;
    else target.removeAttribute("tabindex");
  }
});
for (const wide of document.querySelectorAll("pre, .table-wrapper")) reachable.observe(wide);

// The theme's headings of the list of chapters have no level.
for (const heading of document.querySelectorAll(".caption[role=heading]")) heading.ariaLevel = 2;

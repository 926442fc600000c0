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

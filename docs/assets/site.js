// Sections of pages that would be longer than 15,000 px are folded; a link to anything inside opens its section.
const article = document.querySelector("article");
if (article && document.documentElement.scrollHeight > 15000) {
  const [few, many] = ["h2", "h3"].map((level) => article.querySelectorAll(level));
  for (const head of many.length > few.length ? many : few) {
    const fold = document.createElement("details");
    const summary = document.createElement("summary");
    let next = head.nextSibling;
    head.before(fold);
    fold.className = "fold";
    fold.append(summary);
    summary.append(head);
    while (next && !/^H[123]$/.test(next.nodeName) && !next.querySelector?.("h2")) {
      const after = next.nextSibling;
      fold.append(next);
      next = after;
    }
  }
  const open = () => {
    const target = document.getElementById(decodeURIComponent(location.hash.slice(1)));
    const fold = target?.closest("details.fold");
    if (fold) {
      fold.open = true;
      target.scrollIntoView();
    }
  };
  addEventListener("hashchange", open);
  addEventListener("load", open);
}

// What the theme leaves out for people who use a keyboard or a screen reader.
document.addEventListener("DOMContentLoaded", () => {
  // Code and tables that scroll sideways can be scrolled with the keyboard only if they can be focused.
  for (const box of document.querySelectorAll(".highlight pre, .table-wrapper")) box.tabIndex = 0;
  // The captions of the page list are headings; headings have a level.
  for (const caption of document.querySelectorAll('.caption[role="heading"]')) caption.setAttribute("aria-level", "2");
  // Two regions of one kind are told apart by their names.
  const names = { ".sidebar-drawer": "All pages", ".toc-drawer": "This page" };
  for (const [place, name] of Object.entries(names)) document.querySelector(place)?.setAttribute("aria-label", name);
});

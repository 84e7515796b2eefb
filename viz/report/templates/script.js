document.documentElement.classList.add("js");
document.querySelectorAll(".slide input").forEach(function (input) {
  input.addEventListener("input", function () {
    input.parentNode.style.setProperty("--at", input.value + "%");
  });
});
function opened(target) {
  for (var element = target; element; element = element.parentElement)
    if (element.tagName === "DETAILS") element.open = true;
}
window.addEventListener("beforeprint", function () {
  document.querySelectorAll("details.family").forEach(opened);
});

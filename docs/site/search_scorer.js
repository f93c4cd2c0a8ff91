// Order of the search: answers first, records of measurements and docstrings last.
// The numbers are Sphinx's own, for a file of this kind replaces all of them.
var Scorer = {
  score: ([docname, title, anchor, descr, score]) => {
    if (/^(start|howto)\//.test(docname)) return score + 12;
    if (/^(validation|reference\/python\/|reference\/changelog|architecture)/.test(docname)) return score - 12;
    return score;
  },
  objNameMatch: 11,
  objPartialMatch: 6,
  objPrio: {0: 15, 1: 5, 2: -5},
  objPrioDefault: 0,
  title: 15,
  partialTitle: 7,
  term: 5,
  partialTerm: 2,
};

// Order of the search. Sphinx shows only pages that hold every word, and takes a page's best word for
// its score. A question in a reader's own words then finds nothing, or anything. Here a page scores
// by the share of the query that it covers: a rare word counts more than a common one, and a word
// of a title, or of the page's keywords (search_words.py), three times as much as one of its text.

var Scorer = {
  // Answers first; records of measurements and docstrings last.
  score: ([docname, title, anchor, descr, score]) => {
    if (/^(start|howto)\//.test(docname)) return score + 4;
    if (/^(validation|reference\/python|reference\/changelog|architecture)/.test(docname)) return score - 8;
    return score;
  },
  // Sphinx's own numbers, for a file of this kind replaces all of them; a title that is the query
  // stands beside a page that covers it.
  objNameMatch: 11,
  objPartialMatch: 6,
  objPrio: {0: 15, 1: 5, 2: -5},
  objPrioDefault: 0,
  title: 30,
  partialTitle: 7,
  term: 5,
  partialTerm: 2,
};

// Words of a question that say nothing about its subject; Sphinx's list has most others.
["can", "do", "does", "get", "how", "make", "much", "my", "see", "use", "want", "when", "where", "why"]
  .forEach((word) => stopwords.add(word));

const IN_TITLE = 3;
const FEW_WORDS = 25;
const WHOLE_QUERY = 30;

/** How much a word of a page's titles tells of the page: little, if there are many headings. */
function weightsOfTitles(index) {
  const words = index.docnames.map(() => 0);
  for (const files of Object.values(index.titleterms)) [files].flat().forEach((file) => (words[file] += 1));
  return words.map((many) => 1 + (IN_TITLE - 1) * Math.min(1, FEW_WORDS / many));
}

/** The pages that hold a word, each with its weight; part of a word counts if the whole is nowhere. */
function pagesWith(word, index, titles) {
  const pages = new Map();
  const note = (files, weight) =>
    [files ?? []].flat().forEach((file) => pages.set(file, Math.max(weight(file), pages.get(file) ?? 0)));
  const own = (words, key) => (Object.hasOwn(words, key) ? words[key] : undefined);
  note(own(index.terms, word), () => 1);
  note(own(index.titleterms, word), (file) => titles[file]);
  if (pages.size === 0 && word.length > 2) {
    for (const [words, weight] of [[index.terms, () => 0.5], [index.titleterms, (file) => titles[file] / 2]])
      Object.keys(words).filter((one) => one.startsWith(word)).forEach((one) => note(words[one], weight));
  }
  return pages;
}

/** In place of Search.performTermsSearch, with its arguments and its results. */
function byCoverage(searchTerms, excludedTerms) {
  const index = Search._index;
  const titles = weightsOfTitles(index);
  const found = [...searchTerms].map((word) => pagesWith(word, index, titles));
  const rarity = found.map((pages) => Math.log(1 + index.docnames.length / Math.max(pages.size, 1)));
  const most = IN_TITLE * rarity.reduce((sum, one) => sum + one, 0);
  const scores = new Map();
  found.forEach((pages, i) => pages.forEach((weight, file) =>
    scores.set(file, (scores.get(file) ?? 0) + (WHOLE_QUERY * weight * rarity[i]) / most)));
  for (const word of excludedTerms) pagesWith(word, index, titles).forEach((_, file) => scores.delete(file));
  return [...scores].map(([file, score]) => [
    index.docnames[file], index.titles[file], "", null, score, index.filenames[file], SearchResultKind.text,
  ]);
}

document.addEventListener("DOMContentLoaded", () => {
  if (typeof Search !== "undefined") Search.performTermsSearch = byCoverage;
});
